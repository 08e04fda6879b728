"""Events: what the service tells the engine.

event_seq rises within a session and identifies the event in its Outcome; 0 means not sequenced. received_at is when the
service read the event. Answers: SetPrompts, SetConstraints, SetVelocity, SetPlayState, SetOptions and Seek get exactly
one Outcome each; Open gets Opened, or an Outcome that refuses it; Resume gets Resumed, unless the session closes first;
Close gets Closed, or an Outcome if no session is open; Playhead and SaveAgain get none.
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
    """Open a session. going_on: what it continues from if another engine had it, with `spec` then as it was there.

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
    """The fields that every event but Open has; the module's docstring explains them."""

    session: SessionKey
    event_seq: int
    received_at: float


@dataclass(frozen=True, slots=True, eq=False)
class SetPrompts(_OfSession):
    """Change prompts as one edit: first `remove`, then `upsert`, which adds or replaces by id."""

    upsert: tuple[Prompt, ...] = ()
    remove: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SetConstraints(_OfSession):
    """Change constraints as one edit: first `clear`, which removes all that are set, then `remove`, then `upsert`."""

    upsert: tuple[Asked, ...] = ()
    remove: tuple[int, ...] = ()
    clear: bool = False


@dataclass(frozen=True, slots=True)
class SetVelocity(_OfSession):
    """Steer the character: x, z in metres per second in the world; heading in radians, None for any.

    Replaces the previous velocity, and ends hold_frames after the first frame that it steers; x = z = 0 means stand.
    keep_prompt: the session's own prompts stay in force meanwhile, instead of the model's gaits.
    """

    x: float
    z: float
    heading: float | None
    hold_frames: int
    keep_prompt: bool = False


class Playhead(NamedTuple):
    """The client's report: the frame being shown, the end of the frames held (exclusive), underruns so far.

    The newest report wins. A frame below an earlier report's is ignored; one beyond what was sent counts as the end of
    what was sent. rtt_s: the stream's measured round trip, None if unknown.

    A named tuple because most events are of this kind, and it takes a third of the time to make.
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
    """Cut: from the first frame that can still change, the character stands at start_pose or goes on from other frames.

    These are prior_rows, (H, row_width) float32, whole patches of them, or the session's own frames before `frame`, if
    that is not 0. start_pose counts only if there are neither.
    """

    start_pose: StartPose
    prior_rows: Float32Array | None = None
    frame: int = 0


@dataclass(frozen=True, slots=True)
class SetOptions(_OfSession):
    """Change options that the session was opened with, from its next window on; None leaves one as it is."""

    priority: Priority | None = None
    lookahead: int | None = None
    denoise_steps: int | None = None
    guidance: Guidance | None = None
    history_frames: int | None = None

    def changed(self, spec: SessionSpec) -> SessionSpec:
        """The session's spec with the new options."""
        names = ("priority", "lookahead", "denoise_steps", "guidance", "history_frames")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return replace(spec, **given)


@dataclass(frozen=True, slots=True)
class Resume(_OfSession):
    """Continue with a client that lost its connection: it holds frames below next_frame, of plans up to `plan`.

    Answered by `Resumed` with the same attempt, which the service counts.
    """

    attempt: int
    next_frame: int
    plan: int


@dataclass(frozen=True, slots=True)
class SaveAgain(_OfSession):
    """The saved session was lost: make a SnapshotTaken although nothing changed. Sent by the service on its own."""


@dataclass(frozen=True, slots=True)
class Close(_OfSession):
    """End the session. The service also sends this for every session of a stream that broke or reads too slowly."""

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
"""Events that get no answer if no session is open; the client of a Resume is told by a Closed."""
