"""What steers a session: prompts, and the kinds of constraint. K: joints of one constraint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

from motiongen_server.engine.types.arrays import Float32Array

# Not an id that a client can choose: those start at 1.
VELOCITY_ID = 0
"""The id of a window's constraints that stem from a velocity: they lead the root, but no client asked for the place."""


@dataclass(frozen=True, slots=True, eq=False)
class Prompt:
    """A text in force from start_frame up to, but not including, end_frame (None: open-ended).

    start_frame None, or a frame that can no longer be replaced, means "from the first frame that can". embedding: (E,)
    or (L, E) float32, as the text encoder made it. Where spans overlap, the one that starts last wins; of equal starts,
    the one set last.
    """

    prompt_id: int
    start_frame: int | None
    end_frame: int | None
    text: str
    embedding: Float32Array

    @property
    def begin(self) -> int:
        """start_frame, or 0 if it has none."""
        return self.start_frame or 0


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far a constraint may be missed and still count as met: metres; radians for heading and rotations."""

    position_m: float = 0.1
    angle_rad: float = 0.25


DEFAULT_TOLERANCE = Tolerance()


@dataclass(frozen=True, slots=True)
class Span:
    """The frames at any of which a constraint may be met. is_led: the character is led there from any distance."""

    first: int
    last: int
    is_led: bool = False


class _Spanned(Protocol):
    @property
    def frame(self) -> int: ...
    @property
    def span(self) -> Span | None: ...


@dataclass(frozen=True, slots=True, eq=False)
class AtFrame:
    """A constraint on a single frame, or on any one frame of a span; `frame` is then the one aimed for.

    weight, of every constraint: where two ask the same feature of a frame, the heavier one wins; of equals, the later
    one.
    """

    constraint_id: int
    frame: int

    @property
    def first_frame(self: _Spanned) -> int:
        return self.frame if self.span is None else self.span.first

    @property
    def last_frame(self: _Spanned) -> int:
        return self.frame if self.span is None else self.span.last


@dataclass(frozen=True, slots=True)
class Waypoint(AtFrame):
    """The root's ground position at one frame, heading optional."""

    x: float
    z: float
    heading: float | None = None
    tolerance: Tolerance = DEFAULT_TOLERANCE
    weight: float = 1.0
    span: Span | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RootTrajectory:
    """Ground positions of the root at consecutive frames. xz: (T, 2); heading: (T,) or None."""

    constraint_id: int
    first_frame: int
    xz: Float32Array
    heading: Float32Array | None = None
    tolerance: Tolerance = DEFAULT_TOLERANCE
    weight: float = 1.0

    @property
    def last_frame(self) -> int:
        return self.first_frame + len(self.xz) - 1


@dataclass(frozen=True, slots=True, eq=False)
class JointTargets(AtFrame):
    """World targets of some joints at one frame; the root is among them or left free.

    positions: (K, 3); rotations: (K, 3, 3) global matrices, or None. rotated: which of the joints have a rotation to
    reach, by default all; the matrices of the others are ignored. contacts: columns of the frame's contact block, at
    least one of which must be on the ground; empty: none need be.
    """

    joints: tuple[int, ...]
    positions: Float32Array
    rotations: Float32Array | None = None
    rotated: tuple[bool, ...] | None = None
    tolerance: Tolerance = DEFAULT_TOLERANCE
    weight: float = 1.0
    span: Span | None = None
    contacts: tuple[int, ...] = ()

    @property
    def turns(self) -> list[int]:
        """The indices, within `joints`, of the joints that have a rotation to reach."""
        count = 0 if self.rotations is None else len(self.joints)
        return [index for index in range(count) if self.rotated is None or self.rotated[index]]


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe(AtFrame):
    """The world positions of all joints at one frame. positions: (J, 3)."""

    positions: Float32Array
    tolerance: Tolerance = DEFAULT_TOLERANCE
    weight: float = 1.0
    span: Span | None = None


@dataclass(frozen=True, slots=True, eq=False)
class HeadingTarget(AtFrame):
    """The root's heading at one frame, wherever it is: radians, 0 toward +Z."""

    heading: float
    tolerance: Tolerance = DEFAULT_TOLERANCE
    weight: float = 1.0
    span: Span | None = None


@dataclass(frozen=True, slots=True, eq=False)
class JointRotations(AtFrame):
    """The rotations of some joints at one frame, wherever they are. rotations: (K, 3, 3) global matrices."""

    joints: tuple[int, ...]
    rotations: Float32Array
    tolerance: Tolerance = DEFAULT_TOLERANCE
    weight: float = 1.0
    span: Span | None = None


Constraint: TypeAlias = Waypoint | RootTrajectory | JointTargets | Keyframe | HeadingTarget | JointRotations


@dataclass(frozen=True, slots=True, eq=False)
class RootPath:
    """Corners (N, 2) of a path over the ground, walked at a speed; it leaves straight lines by smoothing_m at most."""

    constraint_id: int
    corners: Float32Array
    speed_mps: float
    smoothing_m: float
    tolerance: Tolerance = DEFAULT_TOLERANCE
    weight: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Unplaced:
    """A constraint whose frames or places depend on where the character is when it takes effect.

    frames_from_effect: its frames count from then. last_frame: it may be met at any frame up to this one. at_any_frame:
    it is to be met as soon as a person could be there. is_relative: its places and angles are relative to the
    character.
    """

    target: Constraint | RootPath
    frames_from_effect: bool = False
    at_any_frame: bool = False
    last_frame: int | None = None
    is_relative: bool = False

    @property
    def constraint_id(self) -> int:
        return self.target.constraint_id


@dataclass(frozen=True, slots=True)
class Placement:
    """Where an `Unplaced` was put: the frames at which it may be met, and arrival_frame, the one aimed for.

    anchor_frame: when it takes effect; x, z, heading: the root just before.
    """

    constraint_id: int
    first_frame: int
    last_frame: int
    arrival_frame: int
    anchor_frame: int
    x: float
    z: float
    heading: float


Asked: TypeAlias = Constraint | Unplaced
"""A constraint as a client asks for it."""
