"""Binary glTF, read as its specification says and without the writer's code: nodes, skin, mesh, animation."""

from __future__ import annotations

import builtins
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import load_skeleton, skeleton_names
from motiongen_ardy.formats.bone_mesh import bone_mesh
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.gltf import write_glb
from tests.ardy.formats.motions import random_motion

WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TYPES = {5121: "<u1", 5126: "<f4"}


class Glb:
    """The two chunks of a .glb, and its accessors as arrays."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", content)
        assert (magic, version, length) == (b"glTF", 2, len(content))
        size, kind = struct.unpack_from("<I4s", content, 12)
        assert kind == b"JSON"
        self.json: dict[str, Any] = json.loads(content[20 : 20 + size])
        binary_size, kind = struct.unpack_from("<I4s", content, 20 + size)
        assert kind == b"BIN\0"
        self.binary = content[28 + size : 28 + size + binary_size]

    def array(self, index: int) -> np.ndarray:
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        width = WIDTHS[accessor["type"]]
        kind = np.dtype(TYPES[accessor["componentType"]])
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == accessor["count"] * width * kind.itemsize
        flat = np.frombuffer(self.binary, kind, accessor["count"] * width, view["byteOffset"])
        return flat.reshape(accessor["count"], width)

    def tracks(self) -> dict[tuple[int, str], np.ndarray]:
        (animation,) = self.json["animations"]
        return {
            (channel["target"]["node"], channel["target"]["path"]): self.array(
                animation["samplers"][channel["sampler"]]["output"]
            )
            for channel in animation["channels"]
        }

    def world(self, frame: int | None) -> np.ndarray:
        """World matrices (nodes, 4, 4) at an animation frame, or at rest."""
        nodes, tracks = self.json["nodes"], self.tracks()
        found = np.tile(np.eye(4), (len(nodes), 1, 1))

        def visit(node: int, above: np.ndarray) -> None:
            values = {"translation": nodes[node].get("translation", [0, 0, 0]), "rotation": nodes[node].get("rotation")}
            for path in values:
                if frame is not None and (node, path) in tracks:
                    values[path] = tracks[node, path][frame]
            x, y, z, w = values["rotation"] if values["rotation"] is not None else (0, 0, 0, 1)
            local = np.eye(4)
            local[:3, :3] = quaternion_to_matrix(torch.tensor([w, x, y, z], dtype=torch.float64)).numpy()
            local[:3, 3] = values["translation"]
            found[node] = above @ local
            for child in nodes[node].get("children", []):
                visit(child, found[node])

        for node in self.json["scenes"][self.json["scene"]]["nodes"]:
            visit(node, np.eye(4))
        return found


@pytest.mark.parametrize("name", skeleton_names())
def test_the_animation_reproduces_the_joint_positions(tmp_path: Path, name: str) -> None:
    skeleton = load_skeleton(name)
    stored = random_motion(skeleton, 6, seed=1, fps=25)
    write_glb(tmp_path / "motion.glb", stored)
    glb = Glb(tmp_path / "motion.glb")
    assert [node["name"] for node in glb.json["nodes"]] == [*skeleton.joint_names, "body"]
    (animation,) = glb.json["animations"]
    assert animation["extras"] == {"text": "a test", "frames_per_second": 25}
    (times,) = {sampler["input"] for sampler in animation["samplers"]}
    np.testing.assert_allclose(glb.array(times)[:, 0], np.arange(6) / 25, atol=1e-6)
    accessor = glb.json["accessors"][times]
    assert (accessor["min"], accessor["max"]) == ([0.0], pytest.approx([0.2]))
    expected = stored.positions().numpy()
    for frame in range(6):
        np.testing.assert_allclose(glb.world(frame)[: skeleton.num_joints, :3, 3], expected[frame], atol=1e-5)


def test_quaternions_have_unit_length_and_never_change_sign(tmp_path: Path) -> None:
    write_glb(tmp_path / "spin.glb", random_motion(load_skeleton("core27"), 200, seed=0))
    for (_, path), values in Glb(tmp_path / "spin.glb").tracks().items():
        if path == "rotation":
            np.testing.assert_allclose(np.linalg.norm(values, axis=1), 1, atol=1e-6)
            assert ((values[1:] * values[:-1]).sum(1) > 0).all()


def test_the_mesh_moves_with_the_bones(tmp_path: Path) -> None:
    """Skinned as viewers do it, the ends of each diamond lie on the joints of its bone."""
    skeleton = load_skeleton("core27")
    stored = random_motion(skeleton, 3, seed=5)
    write_glb(tmp_path / "motion.glb", stored)
    glb = Glb(tmp_path / "motion.glb")
    (primitive,) = glb.json["meshes"][0]["primitives"]
    positions = glb.array(primitive["attributes"]["POSITION"])
    joints = glb.array(primitive["attributes"]["JOINTS_0"])[:, 0]
    np.testing.assert_array_equal(glb.array(primitive["attributes"]["WEIGHTS_0"]), [[1, 0, 0, 0]] * len(positions))
    np.testing.assert_allclose(np.linalg.norm(glb.array(primitive["attributes"]["NORMAL"]), axis=1), 1, atol=1e-5)
    bounds = glb.json["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_allclose([bounds["min"], bounds["max"]], [positions.min(0), positions.max(0)], atol=1e-6)
    (skin,) = glb.json["skins"]
    assert skin["joints"] == list(range(27))
    unbind = glb.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    homogeneous = np.concatenate([positions, np.ones((len(positions), 1))], axis=1)
    for frame in (0, 2):
        world = glb.world(frame)[:27]
        skinned = np.einsum("vij,vj->vi", (world @ unbind)[joints], homogeneous)[:, :3].reshape(-1, 24, 3)
        bones = [
            (skeleton.parents[joint], joint) for joint in range(1, 27) if np.linalg.norm(skeleton.offsets[joint]) > 1e-4
        ]
        assert len(skinned) == len(bones)
        at = stored.positions()[frame].numpy()
        for diamond, (parent, joint) in zip(skinned, bones, strict=True):
            assert np.linalg.norm(diamond - at[parent], axis=1).min() < 1e-4
            assert np.linalg.norm(diamond - at[joint], axis=1).min() < 1e-4
    lowest = glb.world(None)[:27, 1, 3].min()
    assert lowest == pytest.approx(0, abs=1e-6), "at rest the body stands on the ground"


def test_a_viewer_finds_the_body_its_skin_and_smooth_motion(tmp_path: Path) -> None:
    skeleton = load_skeleton("core27")
    write_glb(tmp_path / "motion.glb", random_motion(skeleton, 3, seed=1))
    glb = Glb(tmp_path / "motion.glb")
    body = [(node.get("mesh"), node.get("skin")) for node in glb.json["nodes"]].index((0, 0))
    assert glb.json["scenes"][glb.json["scene"]]["nodes"] == [0, body]
    assert {sampler["interpolation"] for sampler in glb.json["animations"][0]["samplers"]} == {"LINEAR"}
    (primitive,) = glb.json["meshes"][0]["primitives"]
    views = [
        glb.json["accessors"][index]["bufferView"] for index in primitive["attributes"].values() if index is not None
    ]
    assert {glb.json["bufferViews"][view]["target"] for view in views} == {34962}  # of vertices, by the specification


def test_every_face_of_the_mesh_looks_outward(tmp_path: Path) -> None:
    """Engines do not draw the back of a face: one that looks inward would be a hole."""
    mesh = bone_mesh(load_skeleton("core27"))
    bones = mesh.positions.reshape(-1, 8, 3, 3).astype(np.float64)  # eight triangles each
    middles = bones.mean(axis=(1, 2), keepdims=True)[:, :, 0]
    wound = np.cross(bones[:, :, 1] - bones[:, :, 0], bones[:, :, 2] - bones[:, :, 0])
    assert ((wound * (bones.mean(axis=2) - middles)).sum(-1) > 0).all()
    normals = mesh.normals.reshape(-1, 8, 3, 3)
    length = np.linalg.norm(wound, axis=-1, keepdims=True)
    np.testing.assert_allclose(normals, np.repeat((wound / length)[:, :, None], 3, axis=2), atol=1e-4)
    write_glb(tmp_path / "motion.glb", random_motion(load_skeleton("core27"), 2, seed=1))
    glb = Glb(tmp_path / "motion.glb")
    written = glb.array(glb.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"])
    np.testing.assert_array_equal(written, mesh.normals)


def test_without_pygltflib_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name == "pygltflib":
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(FormatError, match=r"pip install 'motiongen-ardy\[gltf\]'"):
        write_glb(tmp_path / "motion.glb", random_motion(load_skeleton("core27"), 2, seed=0))
    assert not (tmp_path / "motion.glb").exists()
