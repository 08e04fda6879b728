"""The values that cross the engine's border: what a session is, what it is told, what the runner gets, what comes out.

Plain frozen dataclasses of numpy arrays and numbers. Units: metres, radians, seconds; right-handed, +Y up, +Z forward.
A frame is an absolute index since the session began, at the model's fps. Times (`_at`, `deadline`) are monotonic
seconds of one clock. Shapes: T frames, J joints, D features, K joints of one constraint, E width of an embedding.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Float32Array: TypeAlias = NDArray[np.float32]


class SessionKey(NamedTuple):
    """One session's address: the stream that carries it, and the client's handle for it on that stream.

    The service may use a key again after the engine has delivered `Closed` for it; nothing of the old session can reach
    the new one.
    """

    stream: int
    handle: int


class Priority(IntEnum):
    """Class of a session, most urgent first; the numbers are those of the protocol."""

    HERO = 1
    NEAR = 2
    CROWD = 3
    BATCH = 4


class PlanCause(IntEnum):
    """Why a plan was made; the numbers are those of the protocol."""

    CONTINUE = 1
    EDIT = 2


class PlayState(IntEnum):
    """Whether the client's clock runs; the numbers are those of the protocol."""

    PLAYING = 1
    PAUSED = 2


class CloseReason(IntEnum):
    """Why a session ended; the numbers are those of the protocol."""

    CLIENT = 1
    IDLE = 2
    SLOW_READER = 3
    DRAINED = 5
    ENGINE_FAULT = 6


class Code(IntEnum):
    """The google.rpc.Code numbers that the engine answers with."""

    OK = 0
    CANCELLED = 1
    INVALID_ARGUMENT = 3
    NOT_FOUND = 5
    ALREADY_EXISTS = 6
    RESOURCE_EXHAUSTED = 8
    FAILED_PRECONDITION = 9
    UNIMPLEMENTED = 12
    INTERNAL = 13
    UNAVAILABLE = 14


# ---- facts about the model ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ChannelBlock:
    """A named run of floats in a frame row, such as ("root_translation_m", 3)."""

    name: str
    width: int


@dataclass(frozen=True, slots=True, eq=False)
class RigLayout:
    """What a client needs to read a frame row and to do forward kinematics alone.

    parents: the parent of each joint, -1 for the root (joint 0); parents precede their children.
    neutral_offsets: (J, 3) float32, metres, each joint relative to its parent; the root's is its neutral position.
    blocks: the row's layout in order; the widths sum to `row_width`.
    """

    rig_id: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    neutral_offsets: Float32Array
    blocks: tuple[ChannelBlock, ...]

    @property
    def row_width(self) -> int:
        return sum(block.width for block in self.blocks)


@dataclass(frozen=True, slots=True)
class ModelFacts:
    """The rates and limits of the loaded model.

    horizon: frames that one window generates. patch: frames of one token. row_width: floats of one frame on the wire.
    feature_dim: D. max_window_frames: history, horizon and future together. Steps are denoising steps per window.
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

    @property
    def row_width(self) -> int:
        return self.rig.row_width

    @property
    def max_history(self) -> int:
        """The longest history that still leaves room for a horizon."""
        return self.max_window_frames - self.horizon


# ---- what a session is made of ---------------------------------------------------------------------------------------


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
class Prompt:
    """A text that holds from start_frame up to, not including, end_frame (None: open-ended).

    start_frame None means "from the first frame that can still be replaced", and so does a frame below that.
    embedding: (E,) or (L, E) float32, as the runner's text encoder gave it. Where spans overlap, the one that starts
    last wins; of equal starts, the one set last.
    """

    prompt_id: int
    start_frame: int | None
    end_frame: int | None
    text: str
    embedding: Float32Array


@dataclass(frozen=True, slots=True)
class RootTarget:
    """A waypoint: the root's ground position at one frame, heading optional."""

    constraint_id: int
    frame: int
    x: float
    z: float
    heading: float | None = None

    @property
    def last_frame(self) -> int:
        return self.frame

    @property
    def first_frame(self) -> int:
        return self.frame


@dataclass(frozen=True, slots=True, eq=False)
class RootPath:
    """A root trajectory: ground positions at consecutive frames. xz: (T, 2); heading: (T,) or None."""

    constraint_id: int
    first_frame: int
    xz: Float32Array
    heading: Float32Array | None = None

    @property
    def last_frame(self) -> int:
        return self.first_frame + len(self.xz) - 1


@dataclass(frozen=True, slots=True, eq=False)
class JointTargets:
    """World targets of some joints at one frame. positions: (K, 3); rotations: (K, 3, 3) global matrices, or None."""

    constraint_id: int
    frame: int
    joints: tuple[int, ...]
    positions: Float32Array
    rotations: Float32Array | None = None

    @property
    def last_frame(self) -> int:
        return self.frame

    @property
    def first_frame(self) -> int:
        return self.frame


@dataclass(frozen=True, slots=True, eq=False)
class PoseTarget:
    """A keyframe: the world positions of all joints at one frame. positions: (J, 3)."""

    constraint_id: int
    frame: int
    positions: Float32Array

    @property
    def last_frame(self) -> int:
        return self.frame

    @property
    def first_frame(self) -> int:
        return self.frame


Constraint: TypeAlias = RootTarget | RootPath | JointTargets | PoseTarget


@dataclass(frozen=True, slots=True, eq=False)
class SessionSpec:
    """Everything a session starts with. lookahead: frames that may be sent beyond the playhead."""

    session: SessionKey
    seed: int
    model_id: str
    priority: Priority
    lookahead: int
    denoise_steps: int
    guidance: Guidance
    start_pose: StartPose = StartPose()
    prompts: tuple[Prompt, ...] = ()
    constraints: tuple[Constraint, ...] = ()


# ---- events: what the service tells the engine -----------------------------------------------------------------------
# event_seq rises within a session and names the event in its Outcome; 0 means not sequenced. received_at is when the
# service read the event. SetPrompts, SetConstraints and SetPlayState get exactly one Outcome each; Open gets Opened, or
# an Outcome that refuses it; Close gets Closed, or an Outcome where no session is open; Playhead gets no answer.


@dataclass(frozen=True, slots=True, eq=False)
class Open:
    spec: SessionSpec
    event_seq: int
    received_at: float

    @property
    def session(self) -> SessionKey:
        return self.spec.session


@dataclass(frozen=True, slots=True, eq=False)
class SetPrompts:
    """Change prompts as one edit: `remove` first, then `upsert`, which adds or replaces by id."""

    session: SessionKey
    event_seq: int
    received_at: float
    upsert: tuple[Prompt, ...] = ()
    remove: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SetConstraints:
    """Change constraints as one edit: `clear` first removes all that stand, then `remove`, then `upsert`."""

    session: SessionKey
    event_seq: int
    received_at: float
    upsert: tuple[Constraint, ...] = ()
    remove: tuple[int, ...] = ()
    clear: bool = False


@dataclass(frozen=True, slots=True)
class Playhead:
    """The client's report: the frame being shown, frames held up to (exclusive), underruns so far. The newest wins.

    A frame below an earlier report's is ignored; one beyond what was sent is taken as the end of what was sent.
    """

    session: SessionKey
    event_seq: int
    received_at: float
    frame: int
    buffered_to: int
    underruns: int


@dataclass(frozen=True, slots=True)
class SetPlayState:
    session: SessionKey
    event_seq: int
    received_at: float
    state: PlayState


@dataclass(frozen=True, slots=True)
class Close:
    """End the session. The service also sends it for every session of a stream that broke or reads too slowly."""

    session: SessionKey
    event_seq: int
    received_at: float
    reason: CloseReason = CloseReason.CLIENT


Event: TypeAlias = Open | SetPrompts | SetConstraints | Playhead | SetPlayState | Close


# ---- between engine and runner ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class WindowJob:
    """One window to denoise: `horizon` frames from first_frame on.

    plan: the session's plan number; with the seed it keys the noise, so the same plan of the same session always starts
    from the same noise, whoever shares its batch. history: (H, D) float32, the normalized features of the H frames
    before first_frame, H a multiple of the patch and often 0; start_pose stands in for it in a session's first window.
    embedding: the prompt's, None for no prompt. constraints: absolute frames, only those that reach past first_frame
    and into the window. deadline: when the frames are due. cause and priority are for the scheduler and the metrics.
    """

    job_id: int
    session: SessionKey
    plan: int
    first_frame: int
    history: Float32Array
    start_pose: StartPose | None
    embedding: Float32Array | None
    constraints: tuple[Constraint, ...]
    seed: int
    num_steps: int
    guidance: Guidance
    deadline: float
    priority: Priority
    cause: PlanCause
    created_at: float


@dataclass(frozen=True, slots=True)
class RowStatus:
    """One row after a denoising step. finite False: the row holds NaN or infinity and is of no more use."""

    job_id: int
    steps_done: int
    finite: bool


@dataclass(frozen=True, slots=True, eq=False)
class WindowResult:
    """A finished window, horizon frames from the job's first_frame on.

    frames: (G, row_width) float32, rows for the wire. features: (G, D) float32, normalized, for later histories.
    """

    job_id: int
    frames: Float32Array
    features: Float32Array


# ---- outputs: what the engine delivers -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Opened:
    """The first output of a session. committed_horizon: least frames from the playhead to what an edit can change."""

    session: SessionKey
    seed: int
    start_frame: int
    lookahead: int
    committed_horizon: int
    denoise_steps: int


@dataclass(frozen=True, slots=True)
class PlanNotice:
    """Precedes the chunks of a plan: what the client holds of older plans at frames >= valid_from is void.

    event_seqs: the edits that first take effect in this plan, in the order they came.
    """

    session: SessionKey
    plan: int
    valid_from: int
    cause: PlanCause
    event_seqs: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Consecutive frames of the newest plan. rows: (T, row_width) float32. Frames below committed_to never change."""

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
    """

    session: SessionKey
    event_seq: int
    code: Code
    effective_frame: int | None = None
    reason: str = ""
    message: str = ""
    field: str = ""
    allowed: str = ""


@dataclass(frozen=True, slots=True)
class Closed:
    """The last output of a session. num_frames: frames sent; late_frames: frames that came after they were due."""

    session: SessionKey
    reason: CloseReason
    code: Code
    message: str
    num_frames: int
    late_frames: int


Output: TypeAlias = Opened | PlanNotice | Chunk | Outcome | Closed
