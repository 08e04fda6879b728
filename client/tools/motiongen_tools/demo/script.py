"""The script of the demo as data: what the characters are asked for, and when.

Angles are degrees to the left of the direction of travel. Places are distances from where the character then is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

STAND, WALK = "a person stands still", "a person walks forward"


@dataclass(frozen=True)
class Say:
    """Replace the prompt."""

    text: str


@dataclass(frozen=True)
class GoTo:
    """Be `metres` away, turn_deg to the left of the way, in_s later: a waypoint."""

    metres: float
    in_s: float
    turn_deg: float = 0.0


@dataclass(frozen=True)
class Turn:
    """Stay on the spot and face turn_deg farther to the left in_s later: a waypoint with a heading."""

    turn_deg: float
    in_s: float


@dataclass(frozen=True)
class Move:
    """Move at a speed, turn_deg to the left of the way, for some seconds: a velocity. 0 m/s stops.

    keep_prompt: whether the prompt stays in force, instead of the model's own for that speed.
    """

    speed_mps: float
    seconds: float
    turn_deg: float = 0.0
    keep_prompt: bool = False


@dataclass(frozen=True)
class Circle:
    """Follow a circle to the left, tangent to the way: a path. It begins begins_s later, together with a prompt."""

    radius_m: float
    speed_mps: float
    seconds: float
    text: str = WALK
    begins_s: float = 1.0


@dataclass(frozen=True)
class Reach:
    """Have a joint up_m above the ground, ahead_m ahead of and left_m to the left of the root, in_s later."""

    joint: str
    up_m: float
    ahead_m: float
    left_m: float
    in_s: float


Action: TypeAlias = Say | GoTo | Turn | Move | Circle | Reach


@dataclass(frozen=True)
class Cue:
    """Actions that are sent together when the character has reached at_s."""

    at_s: float
    actions: tuple[Action, ...]


@dataclass(frozen=True)
class Role:
    """A character: the prompt it opens with, and its cues in order of time."""

    name: str
    prompt: str
    cues: tuple[Cue, ...]


STORY_S = 18.5
PLACE_BOUND_M = 0.2  # by how much a waypoint may be missed

STORY = Role(
    "story",
    STAND,
    (
        Cue(2.0, (Say(WALK),)),
        Cue(5.0, (Say("a person turns left while walking"), Move(1.0, 2.5, turn_deg=90, keep_prompt=True))),
        Cue(7.5, (Say(WALK), GoTo(2.4, in_s=2.5))),  # on the way
        Cue(10.0, (GoTo(2.0, in_s=3.0, turn_deg=-70),)),  # off it
        Cue(13.0, (Say(STAND), Move(0, 2.5))),
        Cue(15.5, (Say("a person waves with the right hand"),)),
    ),
)

BESIDE = (
    Role(
        "run",
        STAND,
        (
            Cue(1.0, (Say("a person runs forward"), Move(3.0, 4.0))),
            Cue(5.0, (Say(STAND),)),
            Cue(9.0, (Say(WALK), Move(1.2, 4.5, turn_deg=180))),
            Cue(13.5, (Say(STAND),)),
        ),
    ),
    Role("circle", STAND, (Cue(1.0, (Circle(1.5, 1.0, 12.0),)), Cue(14.0, (Say(STAND),)))),
    Role("turn", STAND, (Cue(2.0, (Turn(90, in_s=2.0),)), Cue(8.0, (Turn(-180, in_s=3.0),)))),
    Role(
        "reach",
        STAND,
        (
            Cue(2.0, (Reach("RightHand", up_m=1.5, ahead_m=0.3, left_m=-0.25, in_s=1.5),)),
            Cue(8.0, (Reach("LeftHand", up_m=1.2, ahead_m=0.35, left_m=0.3, in_s=1.5),)),
        ),
    ),
    Role(
        "styles",
        "an elderly person walks forward",
        (Cue(6.0, (Say("a person walks forward happily"),)), Cue(12.0, (Say("a tired person walks forward"),))),
    ),
    Role(
        "gestures",
        STAND,
        (
            Cue(2.0, (Say("a person raises the left hand"),)),
            Cue(7.0, (Say("a person raises both hands"),)),
            Cue(12.0, (Say("a person waves with both hands"),)),
        ),
    ),
    Role("outside", WALK, (Cue(6.0, (Say("a person sits down on a chair"),)),)),
)

CAST = (STORY, *BESIDE)
