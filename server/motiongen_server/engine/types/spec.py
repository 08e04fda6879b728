"""What a session is opened with."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.engine.types.arrays import Float32Array
from motiongen_server.engine.types.conditions import Asked, Prompt
from motiongen_server.engine.types.locomotion import Gait
from motiongen_server.engine.types.names import Priority, SessionKey
from motiongen_server.engine.types.owner import NOBODY, Owner


@dataclass(frozen=True, slots=True)
class Guidance:
    """The weights of the two guidance terms; 0 turns a term off."""

    text: float
    constraint: float


@dataclass(frozen=True, slots=True)
class StartPose:
    """Where a character stands before its first frame: metres on the ground, and heading in radians, 0 toward +Z."""

    x: float = 0.0
    z: float = 0.0
    heading: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SessionSpec:
    """Everything a session is opened with. lookahead: frames that may be sent beyond the playhead.

    history_frames: most frames of history that a window sees, a multiple of the patch; None for the engine's default.
    prior_rows: (H, row_width) float32, the frames just before frame 0, whole patches of them; start_pose counts only
    without them. clip_frames: not None makes the session a clip of that many frames, made as fast as there is room
    beside the sessions and never degraded; it has no playhead, and closes itself after its last frame. gaits: the
    prompts in force while a velocity is; none: the session's own are. keep_prompts: its own prompts stay in force even
    where constraints ask the root for a pace that contradicts them. owner: whose share of the machine it uses. outputs:
    names from `ModelFacts.outputs`; these blocks follow those of the rig in each row, in this order.
    """

    session: SessionKey
    seed: int
    model_id: str
    priority: Priority
    lookahead: int
    denoise_steps: int
    guidance: Guidance
    start_pose: StartPose = StartPose()
    prompts: tuple[Prompt, ...] = ()
    constraints: tuple[Asked, ...] = ()
    history_frames: int | None = None
    prior_rows: Float32Array | None = None
    clip_frames: int | None = None
    gaits: tuple[Gait, ...] = ()
    keep_prompts: bool = False
    owner: Owner = NOBODY
    outputs: tuple[str, ...] = ()

    @property
    def is_clip(self) -> bool:
        return self.clip_frames is not None
