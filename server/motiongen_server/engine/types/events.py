"""Events: what the service tells the engine.

event_seq rises within a session and names the event in its Outcome; 0 means not sequenced. received_at is when the
service read the event. SetPrompts, SetConstraints, SetVelocity, SetPlayState, SetOptions and Seek get exactly one
Outcome each; Open gets Opened, or an Outcome that refuses it; Resume gets Resumed, or a Closed crosses it; Close gets
Closed, or an Outcome where no session is open; Playhead and SaveAgain get no answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

from motiongen_server.engine.types.arrays import Float32Array
from motiongen_server.engine.types.conditions import Asked, Prompt
from motiongen_server.engine.types.names import CloseReason, PlayState, Priority, SessionKey
from motiongen_server.engine.types.snapshot import GoingOn
from motiongen_server.engine.types.spec import Guidance, SessionSpec, StartPose


@dataclass(frozen=True, slots=True, eq=False)
class Open:
    """going_on: with a session that another engine had, of which `spec` is that of then; None: a new one.

    Opened is then followed by Resumed, as if a Resume had been sent.
    """

    spec: SessionSpec
    event_seq: int
    received_at: float
    going_on: GoingOn | None = None

    @property
    def session(self) -> SessionKey:
        return self.spec.session


@dataclass(frozen=True, slots=True, eq=False)
class _OfSession:
    """What the module's docstring says of every event."""

    session: SessionKey
    event_seq: int
    received_at: float


@dataclass(frozen=True, slots=True, eq=False)
class SetPrompts(_OfSession):
    """Change prompts as one edit: `remove` first, then `upsert`, which adds or replaces by id."""

    upsert: tuple[Prompt, ...] = ()
    remove: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SetConstraints(_OfSession):
    """Change constraints as one edit: `clear` first removes all that stand, then `remove`, then `upsert`."""

    upsert: tuple[Asked, ...] = ()
    remove: tuple[int, ...] = ()
    clear: bool = False


@dataclass(frozen=True, slots=True)
class SetVelocity(_OfSession):
    """Move so fast for so long: x, z in metres a second in the world, heading in radians or None for any.

    Replaces the velocity before it, and ends hold_frames after the first frame that it steers; x = z = 0 is to stand.
    keep_prompt: the session's own prompts hold meanwhile, not the gaits of its model.
    """

    x: float
    z: float
    heading: float | None
    hold_frames: int
    keep_prompt: bool = False


class Playhead(NamedTuple):
    """The client's report: the frame being shown, frames held up to (exclusive), underruns so far. The newest wins.

    A frame below an earlier report's is ignored; one beyond what was sent is taken as the end of what was sent.
    rtt_s: the stream's measured round trip, None while it is not known.

    Of all events these are almost all, and a tuple is made in a third of the time.
    """

    session: SessionKey
    event_seq: int
    received_at: float
    frame: int
    buffered_to: int
    underruns: int
    rtt_s: float | None = None


@dataclass(frozen=True, slots=True)
class SetPlayState(_OfSession):
    state: PlayState


@dataclass(frozen=True, slots=True, eq=False)
class Seek(_OfSession):
    """Cut: the character stands at start_pose from the first frame that can still change, or goes on from prior_rows.

    prior_rows: (H, row_width) float32, whole patches of them; start_pose counts only where there are none. frame: one
    of the session's own, and those before it are what it goes on from; 0 for none.
    """

    start_pose: StartPose
    prior_rows: Float32Array | None = None
    frame: int = 0


@dataclass(frozen=True, slots=True)
class SetOptions(_OfSession):
    """Change what the session was opened with, from its next window on; None leaves it."""

    priority: Priority | None = None
    lookahead: int | None = None
    denoise_steps: int | None = None
    guidance: Guidance | None = None
    history_frames: int | None = None

    def changed(self, spec: SessionSpec) -> SessionSpec:
        """What the session is from then on."""
        names = ("priority", "lookahead", "denoise_steps", "guidance", "history_frames")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return replace(spec, **given)


@dataclass(frozen=True, slots=True)
class Resume(_OfSession):
    """Go on with a client that lost its transport: it holds frames below next_frame, of plans up to `plan`.

    Answered by `Resumed` with the same attempt, which the service counts.
    """

    attempt: int
    next_frame: int
    plan: int


@dataclass(frozen=True, slots=True)
class SaveAgain(_OfSession):
    """What was saved of the session is lost: let a SnapshotTaken follow, though nothing is new. The service's own."""


@dataclass(frozen=True, slots=True)
class Close(_OfSession):
    """End the session. The service also sends it for every session of a stream that broke or reads too slowly."""

    reason: CloseReason = CloseReason.CLIENT


Event: TypeAlias = (
    Open
    | SetPrompts
    | SetConstraints
    | SetVelocity
    | Playhead
    | SetPlayState
    | SetOptions
    | Seek
    | Resume
    | SaveAgain
    | Close
)
UNTOLD: TypeAlias = Playhead | Resume | SaveAgain
"""Events of which nothing is said where no session is open; what a Resume asks for is told by a Closed."""
