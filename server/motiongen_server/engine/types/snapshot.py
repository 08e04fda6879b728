"""SessionSnapshot: all that a session is, for an engine elsewhere to go on with it. Plain data."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.engine.types.arrays import Float32Array
from motiongen_server.engine.types.conditions import Constraint, Placement, Prompt
from motiongen_server.engine.types.locomotion import Gait
from motiongen_server.engine.types.names import PlayState, SessionKey
from motiongen_server.engine.types.spec import SessionSpec


@dataclass(frozen=True, slots=True)
class UnansweredEdit:
    """An edit that no plan has answered yet; the conditions hold it already. dirty_from: the first frame it changes.

    placements: where its constraints were put that left that to the engine.
    """

    event_seq: int
    kind: str
    dirty_from: int
    placements: tuple[Placement, ...] = ()


@dataclass(frozen=True, slots=True)
class AnnouncedPlan:
    """A plan that the client may not have heard of, and those before it that it has outdone.

    sent_to: the end of all frames sent before it, exclusive. event_seqs: the edits that first take effect in it.
    """

    plan: int
    valid_from: int
    sent_to: int
    event_seqs: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class HeldVelocity:
    """A velocity in force: metres a second, radians or None. steers_from: None while no window that obeys it landed."""

    x: float
    z: float
    heading: float | None
    hold_frames: int
    steers_from: int | None


@dataclass(frozen=True, slots=True, eq=False)
class SessionSnapshot:
    """A session as of the end of one step.

    spec: what it was opened with, without what the rest holds as it is now, and without its model's gaits. plan: the
    newest. last_seq: the last event that the engine had taken; unanswered: those up to it without an answer.
    rows: (T, row_width) float32, the frames from first_frame on that can be sent, replaced, or be history; those below
    motion_from are no history. committed_to, num_frames, late_frames: of its delivery. is_started: whether its
    client had begun to play. plans: see AnnouncedPlan. measured_to: constraints were measured below that frame.
    correction: what the next window is to put right in the one that began at lost_from, as a number; 0: nothing.
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
        """The first frame that it does not hold."""
        return self.first_frame + len(self.rows)


@dataclass(frozen=True, slots=True, eq=False)
class SnapshotTaken:
    """The session as of the outputs before this one."""

    session: SessionKey
    snapshot: SessionSnapshot


@dataclass(frozen=True, slots=True, eq=False)
class GoingOn:
    """What an Open goes on from, and where its client is: it shows the frame playhead, holds those below next_frame, of
    plans up to `plan`, and was promised those below committed_to. attempt: as in Resume.
    """

    snapshot: SessionSnapshot
    attempt: int
    next_frame: int
    plan: int
    playhead: int
    committed_to: int
