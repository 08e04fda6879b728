"""Every writer of the library leaves the old file if the disk is full or the write is interrupted."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
import safetensors.numpy
import safetensors.torch
import torch

from motiongen_ardy.checkpoint.paces_file import write_paces
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.formats.__main__ import main
from motiongen_ardy.formats.constraints import RootConstraint, write_constraints
from motiongen_ardy.formats.files import write_motion
from motiongen_ardy.formats.root_points import RootPoints, write_root_points
from motiongen_ardy.model.sampling.paces import PromptPaces
from motiongen_ardy.text import HashedTextEncoder
from motiongen_ardy.text.domain import make_domain, write_domain
from motiongen_ardy.text.prompt_file import PromptFileError, encode_prompts, write_prompt_file
from tests.ardy.formats.motions import random_motion

WALK = random_motion(load_skeleton("g134"), 4, seed=1, fps=25)
PROMPTS = encode_prompts(HashedTextEncoder(4), [("wave", "a person waves")])


def constraints(path: Path) -> None:
    write_constraints(path, [RootConstraint((3,), torch.zeros(1, 2))])


def domain(path: Path) -> None:
    write_domain(path, make_domain("hashed-4", np.eye(4, dtype=np.float32), 4))


def paces(path: Path) -> None:
    one = torch.ones(1, 4)
    write_paces(
        path, PromptPaces(one[0].clone(), one, torch.ones(1, 2), 0.5, one.clone(), torch.zeros(1), torch.zeros(1))
    )


def root_points(path: Path) -> None:
    write_root_points(path, RootPoints((3,), torch.zeros(1, 3)))


WRITERS: list[tuple[str, Callable[..., object], tuple[Any, str]]] = [
    ("walk.npz", write_motion, (np, "savez")),
    ("walk.bvh", write_motion, (np, "savetxt")),
    ("walk.csv", write_motion, (np, "savetxt")),
    ("walk.controller.csv", write_motion, (np, "savetxt")),
    ("walk.glb", write_motion, (pygltflib.GLTF2, "save_to_bytes")),
    ("list.json", constraints, (Path, "write_text")),
    ("path.json", root_points, (Path, "write_text")),
    ("prompts.safetensors", write_prompt_file, (safetensors.numpy, "save_file")),
    ("prompt_domain.safetensors", domain, (safetensors.numpy, "save_file")),
    ("prompt_paces.safetensors", paces, (safetensors.torch, "save_file")),
]
MORE: dict[Callable[..., object], list[Any]] = {write_motion: [WALK], write_prompt_file: [PROMPTS]}


@pytest.mark.parametrize(("name", "write", "last"), WRITERS)
@pytest.mark.parametrize(
    "ends_by", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["full", "ctrl-c"]
)
def test_a_failed_write_leaves_the_old_file(
    name: str, write: Callable[..., object], last: tuple[Any, str], ends_by: BaseException,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    path = tmp_path / name
    path.write_bytes(b"of yesterday")

    def fail(*given: Any, **_: Any) -> None:
        for one in given:  # a function that is given the path has begun to write to it
            if isinstance(one, Path):
                one.write_bytes(b"half")
        raise ends_by

    monkeypatch.setattr(*last, fail)
    with pytest.raises((type(ends_by), PromptFileError)):
        write(path, *MORE.get(write, []))
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [(name, b"of yesterday")]


@pytest.mark.parametrize(("name", "write"), [(name, write) for name, write, _ in WRITERS])
def test_a_named_pipe_receives_the_file_and_remains_a_pipe(
    name: str, write: Callable[..., object], tmp_path: Path
) -> None:
    file, pipe = tmp_path / f"file-{name}", tmp_path / name
    write(file, *MORE.get(write, []))
    os.mkfifo(pipe)
    with os.fdopen(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), "rb") as reading:
        fcntl.fcntl(reading, fcntl.F_SETPIPE_SZ, 1 << 20)
        write(pipe, *MORE.get(write, []))
        assert len(reading.read()) == file.stat().st_size
    assert pipe.is_fifo()


def test_the_command_leaves_the_old_file_if_writing_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_motion(tmp_path / "walk.npz", WALK)
    (tmp_path / "walk.bvh").write_text("of yesterday")

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savetxt", full)
    assert main([str(tmp_path / "walk.npz"), str(tmp_path / "walk.bvh")]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert (tmp_path / "walk.bvh").read_text() == "of yesterday"
