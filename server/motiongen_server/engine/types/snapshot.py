"""SessionSnapshot: the state that an engine elsewhere needs to continue a session. Plain data."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.engine.types.arrays import Float32Array
from motiongen_server.engine.types.conditions import Constraint, Placement, Prompt
from motiongen_server.engine.types.locomotion import Gait
from motiongen_server.engine.types.names import PlayState, SessionKey
from motiongen_server.engine.types.spec import SessionSpec


@dataclass(frozen=True, slots=True)
class UnansweredEdit:
    """An edit that no plan has answered yet, although the conditions include it. dirty_from: the first frame to change.

    placements: of those of its constraints that left them to the engine.
    """

    event_seq: int
    kind: str
    dirty_from: int
    placements: tuple[Placement, ...] = ()


@dataclass(frozen=True, slots=True)
class AnnouncedPlan:
    """A plan that the client may not have heard of, merged with earlier ones that it replaced entirely.

    sent_to: the end of all frames sent before it, exclusive. event_seqs: the edits that first take effect in it.
    """

    plan: int
    valid_from: int
    sent_to: int
    event_seqs: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class HeldVelocity:
    """A velocity in force: metres per second, radians or None. steers_from: None until a window that obeys it lands."""

    x: float
    z: float
    heading: float | None
    hold_frames: int
    steers_from: int | None


@dataclass(frozen=True, slots=True, eq=False)
class SessionSnapshot:
    """A session as of the end of one step.

    spec: with its current options, without its model's gaits and without what the other fields hold in its current
    state. plan: the newest plan. last_seq: the last event that the engine had taken; unanswered: edits up to it without
    an answer. rows: (T, row_width) float32, the frames from first_frame on that can be sent, replaced, or be history;
    those below motion_from cannot be history. committed_to, num_frames, late_frames: of its delivery. is_started:
    whether its client had begun to play. plans: see AnnouncedPlan. measured_to: constraints were measured below that
    frame. correction: the number of the correction that the next window makes, for the window that began at lost_from;
    0: none.
    """

    spec: SessionSpec
    plan: int
    last_seq: int
    unanswered: tuple[UnansweredEdit, ...]
    prompts: tuple[Prompt, ...]
    constraints: tuple[Constraint, ...]
    velocity: HeldVelocity | None
    gait: Gait | None
    first_frame: int
    motion_from: int
    rows: Float32Array
    committed_to: int
    num_frames: int
    late_frames: int
    is_started: bool
    play_state: PlayState
    underruns: int
    plans: tuple[AnnouncedPlan, ...]
    measured_to: int
    correction: int = 0
    lost_from: int = 0

    @property
    def end_frame(self) -> int:
        """The first frame after those held."""
        return self.first_frame + len(self.rows)


@dataclass(frozen=True, slots=True, eq=False)
class SnapshotTaken:
    """The session's state after the outputs before this one."""

    session: SessionKey
    snapshot: SessionSnapshot


@dataclass(frozen=True, slots=True, eq=False)
class GoingOn:
    """What an Open continues from, and the client's state.

    The client shows the frame playhead, holds the frames below next_frame, of plans up to `plan`, and was promised the
    frames below committed_to. attempt: as in Resume.
    """

    snapshot: SessionSnapshot
    attempt: int
    next_frame: int
    plan: int
    playhead: int
    committed_to: int
