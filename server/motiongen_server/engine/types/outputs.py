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
    """A request that was accepted but may not turn out as asked. Given by the edge, which knows the model's training.

    reason: an UPPER_SNAKE word that a program can act on; field: the path of the field it concerns, in the protocol's
    terms.
    """

    reason: str
    message: str
    field: str


@dataclass(frozen=True, slots=True)
class Opened:
    """The first output of a session. committed_horizon: least frames from the playhead to what an edit can change.

    placements: of the constraints that it was opened with. The service fills in warnings, session_id, session_token,
    scalar_type and outputs.
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


@dataclass(slots=True)  # not frozen: that would take six times as long to make
class PlanNotice:
    """Precedes the chunks of a plan: frames >= valid_from that the client holds of older plans are void.

    event_seqs: the edits that first take effect in this plan, in order of arrival. timing: of the plan's window, if
    traces are on.
    """

    session: SessionKey
    plan: int
    valid_from: int
    cause: PlanCause
    event_seqs: tuple[int, ...]
    timing: WindowTiming | None = None


@dataclass(slots=True, eq=False)  # not frozen: that would take six times as long to make
class Chunk:
    """Consecutive frames of the newest plan. Frames below committed_to never change.

    rows: (T, row_width) float32, wider by the widths of the outputs that the session asked for.
    """

    session: SessionKey
    plan: int
    first_frame: int
    rows: Float32Array
    committed_to: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """The answer to one event. code OK: in effect from effective_frame on. Otherwise the event changed nothing.

    effective_frame: None if refused, or if no frame changes. reason: an UPPER_SNAKE word that a program can act on;
    field: the path of the field at fault, in the protocol's terms; allowed: what it may contain. All empty if OK.
    retry_after_s: when to ask again, None if that does not help. placements: of constraints that left their frames or
    places to the engine.
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
    """The mean and the largest of some errors."""

    mean: float
    worst: float


@dataclass(frozen=True, slots=True)
class ConstraintReached:
    """How well a constraint was met, reported once, after the chunk that commits its last frame.

    met: every error is within its tolerance. frame: the last frame of the constraint, or of a span the one that came
    nearest. num_frames: frames that were measured. position_m: metres; heading_rad, rotation_rad: radians, 0 to pi;
    None if the constraint asks for nothing of that kind.
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
    """From now on the session's windows are made at this tier, with this many denoising steps each."""

    session: SessionKey
    tier: ServiceTier
    denoise_steps: int


@dataclass(frozen=True, slots=True)
class Resumed:
    """Precedes what a resuming client is sent. start_frame: the next frame sent; None: the frames are no longer held.

    notice: stands for all plans that the client missed; None if it missed none.
    """

    session: SessionKey
    attempt: int
    start_frame: int | None
    notice: PlanNotice | None = None


@dataclass(frozen=True, slots=True)
class Closed:
    """The last output of a session. num_frames: frames sent; late_frames: frames sent after they were due."""

    session: SessionKey
    reason: CloseReason
    code: Code
    message: str
    num_frames: int
    late_frames: int


@dataclass(frozen=True, slots=True)
class Durable:
    """Every event up to durable_seq is in the stored snapshot. Made by the service, not by an engine.

    is_kept: later events will be stored too; False: nothing more is stored at present, and clients are told so.
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
