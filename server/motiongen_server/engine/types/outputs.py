"""Outputs: what the engine delivers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from motiongen_server.engine.types.arrays import Float32Array
from motiongen_server.engine.types.blocks import ChannelBlock
from motiongen_server.engine.types.conditions import Placement
from motiongen_server.engine.types.names import CloseReason, Code, PlanCause, ServiceTier, SessionKey
from motiongen_server.engine.types.snapshot import SnapshotTaken
from motiongen_server.engine.types.tracing import WindowTiming


@dataclass(frozen=True, slots=True)
class Warned:
    """What was taken but may not come out as asked. The engine warns of nothing; what knows the model's training does.

    reason: an UPPER_SNAKE word a program can act on; field: the path of the field it is about, in the protocol's words.
    """

    reason: str
    message: str
    field: str


@dataclass(frozen=True, slots=True)
class Opened:
    """The first output of a session. committed_horizon: least frames from the playhead to what an edit can change.

    placements: of the constraints that it came with. warnings, session_id, session_token and
    scalar_type, outputs: the service fills them in.
    """

    session: SessionKey
    seed: int
    start_frame: int
    lookahead: int
    committed_horizon: int
    denoise_steps: int
    model_id: str
    rig_id: str
    fps: int
    warnings: tuple[Warned, ...] = ()
    session_id: str = ""
    session_token: str = ""
    placements: tuple[Placement, ...] = ()
    scalar_type: int = 1
    outputs: tuple[ChannelBlock, ...] = ()


@dataclass(slots=True)  # frozen, one takes six times as long to make
class PlanNotice:
    """Precedes the chunks of a plan: what the client holds of older plans at frames >= valid_from is void.

    event_seqs: the edits that first take effect in this plan, in the order they came. timing: of the window that it
    is made of, where traces are asked for.
    """

    session: SessionKey
    plan: int
    valid_from: int
    cause: PlanCause
    event_seqs: tuple[int, ...]
    timing: WindowTiming | None = None


@dataclass(slots=True, eq=False)  # frozen, one takes six times as long to make
class Chunk:
    """Consecutive frames of the newest plan. Frames below committed_to never change.

    rows: (T, row_width) float32, and with the outputs that the session asked for (T, row_width + theirs).
    """

    session: SessionKey
    plan: int
    first_frame: int
    rows: Float32Array
    committed_to: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """The answer to one event. code OK: in effect from effective_frame on. Otherwise the event changed nothing.

    effective_frame: None when refused, or when no frame is altered. reason: an UPPER_SNAKE word a program can act on;
    field: the path of the field at fault, in the protocol's words; allowed: what may stand there. All empty when OK.
    retry_after_s: when to ask again, where that may help; None otherwise. placements: of constraints that left their
    frames or places to the engine.
    """

    session: SessionKey
    event_seq: int
    code: Code
    effective_frame: int | None = None
    reason: str = ""
    message: str = ""
    field: str = ""
    allowed: str = ""
    retry_after_s: float | None = None
    warnings: tuple[Warned, ...] = ()
    placements: tuple[Placement, ...] = ()


@dataclass(frozen=True, slots=True)
class Deviation:
    """The mean and the greatest of some errors."""

    mean: float
    worst: float


@dataclass(frozen=True, slots=True)
class ConstraintReached:
    """What became of a constraint, told once, after the chunk that promises its last frame.

    met: every error is within its tolerance. frame: the last that it asks for, or of a span the one that came nearest.
    num_frames: those that were measured.
    position_m: metres; heading_rad, rotation_rad: radians, 0 to pi. None: it asks for nothing of that kind.
    """

    session: SessionKey
    constraint_id: int
    met: bool
    frame: int
    num_frames: int
    position_m: Deviation | None
    heading_rad: Deviation | None
    rotation_rad: Deviation | None


@dataclass(frozen=True, slots=True)
class ServiceLevel:
    """The session's windows are made at this tier from now on, with so many denoising steps each."""

    session: SessionKey
    tier: ServiceTier
    denoise_steps: int


@dataclass(frozen=True, slots=True)
class Resumed:
    """What follows is for a client that resumes. start_frame: the next frame sent; None: it is not held any more.

    notice: in place of all the plans that the client missed, None where it missed none.
    """

    session: SessionKey
    attempt: int
    start_frame: int | None
    notice: PlanNotice | None = None


@dataclass(frozen=True, slots=True)
class Closed:
    """The last output of a session. num_frames: frames sent; late_frames: frames that came after they were due."""

    session: SessionKey
    reason: CloseReason
    code: Code
    message: str
    num_frames: int
    late_frames: int


@dataclass(frozen=True, slots=True)
class Durable:
    """What of the session outlives the server: every event up to durable_seq. The service says it, no engine.

    is_kept: later ones will too; False: nothing more is saved at present, and clients are told.
    """

    session: SessionKey
    durable_seq: int
    is_kept: bool


Output: TypeAlias = (
    Opened
    | PlanNotice
    | Chunk
    | Outcome
    | ConstraintReached
    | ServiceLevel
    | Resumed
    | SnapshotTaken
    | Durable
    | Closed
)
