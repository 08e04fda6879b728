"""Malformed files: good files with bytes changed, and files assembled from the words of a format."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hypothesis import strategies as st

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.formats.bvh import read_bvh, write_bvh
from motiongen_ardy.formats.client_npz import read_client_npz
from motiongen_ardy.formats.constraints import (
    LIMB_TYPES,
    TYPES,
    RootConstraint,
    constraint_targets,
    pose_constraint,
    read_constraints,
    write_constraints,
)
from motiongen_ardy.formats.g1_csv import (
    qpos_motion,
    read_controller_csv,
    read_qpos_csv,
    write_controller_csv,
    write_qpos_csv,
)
from motiongen_ardy.formats.npz import read_npz, write_npz
from motiongen_ardy.formats.root_points import RootPoints, read_root_points, write_root_points
from motiongen_tools.npz import write_npz as write_client_npz
from tests.ardy.formats.client_motion import client_motion
from tests.ardy.formats.motions import random_motion
from tests.ardy.robot.poses import walking_qpos

CORE = load_skeleton("core27")
ODD_NUMBERS = (0, -1, 1, 2**31, 2**63, 10**400, 1e308, -0.0, 5e-324, 0.5)
WORDS = (
    "type", "frame_indices", "root_2d", "smooth_root_2d", "global_root_heading", "local_joints_rot", "root_positions",
    "joint_names", "keyframes", "trajectory", "dense_trajectory", "0", "1", "LeftHand", "Hips", *TYPES,
)  # fmt: skip
ARRAY_NAMES = ("local_rot_mats", "root_positions", "posed_joints", "foot_contacts", "fps", "text", "other")
CLIENT_ARRAY_NAMES = ("root_translation_m", "joint_rotation_quat_wxyz", "foot_contact", "joint_names", "frame_rate_hz")
BVH_WORDS = (
    "HIERARCHY", "ROOT", "JOINT", "End Site", "OFFSET", "CHANNELS", "MOTION", "Frames:", "Frame Time:", "{", "}", "\n",
    "Hips", "Spine", "Xposition", "Yrotation", "Zrotation", "0", "1", "3", "-1", "6", "1e999", "nan", "²", "0.05",
)  # fmt: skip


@dataclass(frozen=True)
class Reader:
    """A reader, good files for it, and content made of its format's words."""

    name: str
    read: Callable[[Path], Any]
    good: tuple[bytes, ...]
    words: st.SearchStrategy[bytes]

    def files(self) -> st.SearchStrategy[bytes]:
        """Any file of these kinds."""
        return st.one_of(st.binary(max_size=300), self.words, changed(self.good))


@st.composite
def changed(draw: st.DrawFn, good: tuple[bytes, ...]) -> bytes:
    """One of the good files with a few spans cut out, doubled, overwritten or moved, or with its end missing."""
    content = draw(st.sampled_from(good))
    for _ in range(draw(st.integers(1, 4))):
        if not content:
            break
        first = draw(st.integers(0, len(content) - 1))
        end = min(len(content), first + draw(st.integers(0, 12)))
        with_what = draw(
            st.sampled_from([b"", b"\0", b"-", b"9" * 12, b"e9", b"nan", b"null", b"[[", b"\n", b"\xff\xff\xff\x7f"])
            | st.binary(max_size=8)
        )
        kind = draw(st.sampled_from(["put", "double", "end"]))
        if kind == "put":
            content = content[:first] + with_what + content[end:]
        elif kind == "double":
            content = content[:end] + content[first:]
        else:
            content = content[:first]
    return content


def json_words() -> st.SearchStrategy[bytes]:
    """JSON of any shape in which the formats' own words come up often."""
    leaf = st.none() | st.booleans() | st.sampled_from(ODD_NUMBERS) | st.sampled_from(WORDS) | st.text(max_size=3)

    def grown(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
        return st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(WORDS), inner, max_size=6)

    entry = st.fixed_dictionaries(
        {"type": st.sampled_from(TYPES), "frame_indices": st.lists(st.sampled_from(ODD_NUMBERS), max_size=2)},
        optional={name: st.recursive(leaf, grown, max_leaves=8) for name in WORDS[2:8]},
    )
    path = st.fixed_dictionaries(
        {"type": st.sampled_from(["keyframes", "dense_trajectory"])},
        optional={
            name: st.dictionaries(st.sampled_from(WORDS), st.lists(leaf, min_size=2, max_size=4), max_size=3)
            for name in ("keyframes", "trajectory")
        },
    )
    trees = st.one_of(st.recursive(leaf, grown, max_leaves=20), st.lists(entry, max_size=3), path)
    return trees.map(lambda tree: json.dumps(tree).encode())


@st.composite
def npz_words(draw: st.DrawFn, names: tuple[str, ...]) -> bytes:
    """A zip whose members have the names that are read, with arrays of any shape and type, or headers of any text."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", draw(st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]))) as archive:
        for name in draw(st.lists(st.sampled_from(names), max_size=5, unique=True)):
            member = io.BytesIO()
            if draw(st.booleans()):
                shape = draw(st.sampled_from([(), (2,), (2, 3), (2, 4), (2, 27, 3), (2, 27, 3, 3), (0, 27, 3, 3)]))
                kind = draw(st.sampled_from(["<f4", "<f8", ">f4", "<f2", "|b1", "<i8", "<U3", "<M8[s]", "|V4", "<c8"]))
                fill = draw(st.sampled_from([0, 1, 20]))
                np.lib.format.write_array(member, np.full(shape, fill).astype(kind), allow_pickle=False)
            else:
                shape_text = draw(
                    st.sampled_from(["(2,)", "(-1,)", "(2**60, 8)", "(99999999999999999999, 3)", "2", ""])
                )
                kind_text = draw(
                    st.sampled_from(["'<f4'", "'|O'", "[('a', '<f4')]", "'<U99999999'", "__import__('os')"])
                )
                header = f"{{'descr': {kind_text}, 'fortran_order': False, 'shape': {shape_text}}}".encode()
                member.write(b"\x93NUMPY" + bytes([draw(st.integers(0, 4)), 0]))
                member.write(len(header).to_bytes(2, "little") + header + draw(st.binary(max_size=40)))
            archive.writestr(f"{name}.npy", member.getvalue())
    return content.getvalue()


def line_words(words: tuple[str, ...], between: str) -> st.SearchStrategy[bytes]:
    return st.lists(st.sampled_from(words), max_size=40).map(lambda chosen: between.join(chosen).encode())


def readers(folder: Path) -> tuple[Reader, ...]:
    """Every reader of `motiongen_ardy.formats`. Good files are written to the folder for this."""
    people, robot = random_motion(CORE, 2, seed=0), qpos_motion("walk", walking_qpos(3, 25), 25)
    at = folder / "good"

    def written(*writers: Callable[[Path], object]) -> tuple[bytes, ...]:
        contents = []
        for write in writers:
            write(at)
            contents.append(at.read_bytes())
        return tuple(contents)

    constraints = [
        RootConstraint((1, 5), torch.ones(2, 2), torch.zeros(2)),
        pose_constraint(people.motion, [1], LIMB_TYPES["left-hand"]),
    ]
    path = RootPoints((1, 2), torch.ones(2, 3))

    def read_targets(given: Path) -> object:
        return constraint_targets(CORE, read_constraints(given, CORE))

    cells = ("0", "1", "-1", "1e999", "nan", "", "x", ",", "\n", '"', ",".join(["0"] * 36), ",".join(["1"] * 36))
    return (
        Reader("constraints", read_targets, written(lambda to: write_constraints(to, constraints)), json_words()),
        Reader("root path", read_root_points, written(lambda to: write_root_points(to, path)), json_words()),
        Reader("npz", read_npz, written(lambda to: write_npz(to, people)), npz_words(ARRAY_NAMES)),
        Reader(
            "client npz",
            read_client_npz,
            written(lambda to: write_client_npz(to, client_motion(people))),
            npz_words(CLIENT_ARRAY_NAMES),
        ),
        Reader("bvh", read_bvh, written(lambda to: write_bvh(to, people)), line_words(BVH_WORDS, " ")),
        Reader("g1 csv", read_qpos_csv, written(lambda to: write_qpos_csv(to, robot)), line_words(cells, ",")),
        Reader(
            "g1 controller csv",
            read_controller_csv,
            written(lambda to: write_controller_csv(to, robot)),
            line_words(cells, ","),
        ),
    )
