"""What the engine knows of a model: its rates, its limits, the layout of a frame row."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.engine.types.arrays import Float32Array
from motiongen_server.engine.types.blocks import ChannelBlock
from motiongen_server.engine.types.spec import Guidance

RELEASED_GUIDANCE = Guidance(2.0, 2.0)

# Names of the blocks that the server itself reads.
ROOT_BLOCK = "root_translation_m"
ROTATION_BLOCK = "joint_rotation_quat_wxyz"
CONTACT_BLOCK = "foot_contact"


@dataclass(frozen=True, slots=True)
class Limb:
    """A part of the body, under the name that motion tools give it: a chain of joints."""

    name: str
    joints: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RigLayout:
    """What a client needs to read a frame row and to do forward kinematics by itself.

    parents: the parent of each joint, -1 for the root (joint 0); parents precede their children. neutral_offsets: (J,
    3) float32, metres, each joint relative to its parent; the root's is its neutral position. blocks: the row's layout
    in order; the widths sum to `row_width`. hip_joints: right and left; the line between them gives a pose's heading;
    None: the root's rotation does. limbs: those that motion tools' constraints refer to.
    """

    rig_id: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    neutral_offsets: Float32Array
    blocks: tuple[ChannelBlock, ...]
    hip_joints: tuple[int, int] | None = None
    limbs: tuple[Limb, ...] = ()

    @property
    def row_width(self) -> int:
        return sum(block.width for block in self.blocks)


@dataclass(frozen=True, slots=True)
class ModelFacts:
    """The rates and limits of the loaded model.

    horizon: frames that one window generates. patch: frames of one token. row_width: floats of one frame on the wire.
    feature_dim: D. max_window_frames: history, horizon and future together. min_steps, max_steps, default_steps:
    denoising steps per window. token_width: floats of one token, root and latent. guidance: the weights of a session
    that gives none; guidance_passes: most evaluations of the denoiser in one step with these; guidance_joint: whether
    one evaluation can take both text and constraints. steered_share: the share of a session's steps that a window gets
    if it follows closely on another one under the same velocity control. longest_flight: frames without a foot in
    contact after which a character counts as lost; 0: no limit. num_parameters: of all networks together. outputs:
    further blocks of a frame row, which a session may ask for.
    """

    model_id: str
    rig: RigLayout
    fps: int
    horizon: int
    patch: int
    feature_dim: int
    max_window_frames: int
    min_steps: int
    max_steps: int
    default_steps: int
    embedding_dim: int
    token_width: int = 0
    guidance_passes: int = 1
    guidance: Guidance = RELEASED_GUIDANCE
    guidance_joint: bool = False
    steered_share: float = 1.0
    longest_flight: int = 0
    num_parameters: int = 0
    outputs: tuple[ChannelBlock, ...] = ()

    @property
    def row_width(self) -> int:
        return self.rig.row_width

    def whole_patches(self, frames: int) -> int:
        """That many frames, rounded down to whole patches, but at least one patch."""
        return max(1, frames // self.patch) * self.patch

    @property
    def max_history(self) -> int:
        """The longest history that still leaves room for a horizon."""
        return self.max_window_frames - self.horizon
