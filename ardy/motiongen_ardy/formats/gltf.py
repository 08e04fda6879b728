"""Motion as binary glTF (.glb): an animated skeleton with a mesh of bones, for engines, browsers and Blender.

glTF uses metres, +Y up and +Z forward, as we do, so nothing is converted. Needs pygltflib (the extra `gltf`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.core.rotation import matrix_to_quaternion
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.formats.bone_mesh import bone_mesh
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.stored import StoredMotion, as_array

if TYPE_CHECKING:
    from pygltflib import GLTF2

_FLOAT, _BYTE = 5126, 5121  # the specification's codes of component types
_ARRAY_BUFFER = 34962
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def write_glb(path: Path, stored: StoredMotion) -> None:
    """Write a motion with any skeleton. Contacts cannot be stored in the file; the text is in the animation's extras.

    Raises FormatError if pygltflib is not installed.
    """
    try:
        import pygltflib
    except ImportError:
        allowed = "install it: pip install 'motiongen-ardy[gltf]'"
        raise FormatError(path, "writing glTF needs pygltflib, which is not installed", allowed) from None
    skeleton, motion = stored.skeleton, stored.motion
    joints = list(range(skeleton.num_joints))
    document = pygltflib.GLTF2(
        scene=0,
        scenes=[pygltflib.Scene(nodes=[0, skeleton.num_joints])],
        nodes=[*_joint_nodes(skeleton), pygltflib.Node(name="body", mesh=0, skin=0)],
        materials=[
            pygltflib.Material(
                name="bone",
                pbrMetallicRoughness=pygltflib.PbrMetallicRoughness(
                    baseColorFactor=[0.6, 0.65, 0.7, 1.0], metallicFactor=0.0, roughnessFactor=0.8
                ),
            )
        ],
    )
    data = _Binary(document)
    mesh = bone_mesh(skeleton)
    members = np.zeros((len(mesh.joints), 4), dtype=np.uint8)
    members[:, 0] = mesh.joints
    weights = np.zeros((len(mesh.joints), 4), dtype=np.float32)
    weights[:, 0] = 1
    attributes = pygltflib.Attributes(
        POSITION=data.add(mesh.positions, bounds=True, target=_ARRAY_BUFFER),
        NORMAL=data.add(mesh.normals, target=_ARRAY_BUFFER),
        JOINTS_0=data.add(members, target=_ARRAY_BUFFER),
        WEIGHTS_0=data.add(weights, target=_ARRAY_BUFFER),
    )
    document.meshes = [
        pygltflib.Mesh(name="bones", primitives=[pygltflib.Primitive(attributes=attributes, material=0)])
    ]
    document.skins = [
        pygltflib.Skin(name=skeleton.name, skeleton=0, joints=joints, inverseBindMatrices=data.add(_unbound(skeleton)))
    ]
    quaternions = _continuous(as_array(matrix_to_quaternion(motion.local_rotations.double())))
    time_s = data.add((np.arange(motion.num_frames) / motion.fps).astype(np.float32)[:, None], bounds=True)
    tracks = [("translation", 0, as_array(motion.root_positions))]
    tracks += [("rotation", joint, quaternions[:, joint, [1, 2, 3, 0]]) for joint in joints]  # x, y, z, w in glTF
    animation = pygltflib.Animation(name="motion", samplers=[], channels=[])
    animation.extras = {"text": stored.text, "frames_per_second": motion.fps}
    for sampler, (what, joint, values) in enumerate(tracks):
        output = data.add(values.astype(np.float32))
        animation.samplers.append(pygltflib.AnimationSampler(input=time_s, output=output, interpolation="LINEAR"))
        target = pygltflib.AnimationChannelTarget(node=joint, path=what)
        animation.channels.append(pygltflib.AnimationChannel(sampler=sampler, target=target))
    document.animations = [animation]
    data.finish()
    with written_whole(path) as partial:
        document.save_binary(partial)


def _joint_nodes(skeleton: Skeleton) -> list[Any]:
    """The skeleton in its neutral pose, standing on the ground."""
    import pygltflib

    nodes = []
    for joint, name in enumerate(skeleton.joint_names):
        offset = skeleton.offsets[joint].tolist()
        if joint == 0:
            offset = [0.0, -float(skeleton.neutral_joints[:, 1].min()), 0.0]
        children = [child for child, parent in enumerate(skeleton.parents) if parent == joint and child != joint]
        nodes.append(pygltflib.Node(name=name, translation=offset, rotation=[0.0, 0.0, 0.0, 1.0], children=children))
    return nodes


def _unbound(skeleton: Skeleton) -> np.ndarray:
    """(J, 16) float32, column-major: inverse bind matrices, from the mesh in the neutral pose to each joint's frame."""
    matrices = np.tile(np.eye(4, dtype=np.float32), (skeleton.num_joints, 1, 1))
    matrices[:, 3, :3] = -skeleton.neutral_joints
    return matrices.reshape(-1, 16)


def _continuous(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (T, J, 4), each with the sign nearest to the one before it: viewers interpolate linearly."""
    turns = np.sign((quaternions[1:] * quaternions[:-1]).sum(-1, keepdims=True))
    signs = np.cumprod(np.concatenate([np.ones_like(quaternions[:1, :, :1]), np.where(turns < 0, -1.0, 1.0)]), axis=0)
    unit: np.ndarray = quaternions * signs / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    return unit


@dataclass
class _Binary:
    """The growing binary part of a document; each array gets a view and an accessor."""

    document: GLTF2
    parts: list[bytes] = field(default_factory=list)
    size: int = 0

    def add(self, values: np.ndarray, bounds: bool = False, target: int | None = None) -> int:
        """Append (N, K) values; returns the accessor's index. bounds: also store the minimum and maximum of each K."""
        import pygltflib

        content = np.ascontiguousarray(values).tobytes()
        view = pygltflib.BufferView(buffer=0, byteOffset=self.size, byteLength=len(content), target=target)
        self.document.bufferViews.append(view)
        accessor = pygltflib.Accessor(
            bufferView=len(self.document.bufferViews) - 1,
            componentType=_BYTE if values.dtype == np.uint8 else _FLOAT,
            count=len(values),
            type=_KINDS[values.shape[1]],
            min=values.min(axis=0).tolist() if bounds else None,
            max=values.max(axis=0).tolist() if bounds else None,
        )
        self.document.accessors.append(accessor)
        padding = b"\0" * (-len(content) % 4)
        self.parts += [content, padding]
        self.size += len(content) + len(padding)
        return len(self.document.accessors) - 1

    def finish(self) -> None:
        import pygltflib

        self.document.buffers = [pygltflib.Buffer(byteLength=self.size)]
        self.document.set_binary_blob(b"".join(self.parts))
