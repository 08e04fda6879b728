"""Turns actions of the script into edits of a session and goals in the world, relative to where the character is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motiongen_client.edit import Edit
from motiongen_client.motion import Motion
from motiongen_client.session import Session
from motiongen_client.types import JointTargets, RootTrajectory, Waypoint
from motiongen_tools.demo.goals import Facing, Goal, Pace, velocities_mps
from motiongen_tools.demo.script import Action, Circle, GoTo, Move, Reach, Say, Turn
from motiongen_tools.poses import headings_rad

_MOVING_MPS = 0.3  # below this speed, a character's way is its heading
_PATH_RAMP_S = 1.0  # time to accelerate from a stand to the speed of a path


@dataclass(frozen=True, eq=False)
class Here:
    """Where a character is. frame: shown now; position_m: (3,), the root's; way_rad: direction of travel or heading."""

    frame: int
    position_m: NDArray[np.float64]
    facing_rad: float
    way_rad: float

    def off(self, metres: float, turn_deg: float) -> tuple[float, float]:
        """The place x, z in metres that is some metres away, turn_deg to the left of the way."""
        angle = self.way_rad + math.radians(turn_deg)
        return self.position_m[0] + metres * math.sin(angle), self.position_m[2] + metres * math.cos(angle)


@dataclass(frozen=True, eq=False)
class Asked:
    """One action as sent. scheduled_frame: where its edit begins, if it is answered only then; None: at once."""

    edit: Edit
    action: Action
    goals: tuple[Goal, ...] = ()
    scheduled_frame: int | None = None


def here(motion: Motion) -> Here:
    """Where a character is at the last frame of its motion."""
    facing = float(headings_rad(Motion(motion.rig, 0, motion.rows[-1:]))[0])
    x, z = velocities_mps(motion)[-1]
    way = math.atan2(x, z) if math.hypot(x, z) > _MOVING_MPS else facing
    position = motion.root_translation_m[-1].astype(np.float64)
    return Here(motion.first_frame + len(motion) - 1, position, facing, way)


def ask(session: Session, action: Action, at: Here) -> list[Asked]:
    """Send an action. Raises UnknownName for a joint that the rig lacks, SessionEnded or StreamLost if it is over."""
    match action:
        case Say(text):
            return [Asked(session.set_prompt(text), action)]
        case Move():
            return [_move(session, action, at)]
        case Circle():
            return _circle(session, action, at)
        case GoTo(metres, in_s, turn):
            x, z = at.off(metres, turn)
            waypoint = Waypoint(at.frame + session.rig.frames_in(in_s), x, z)
            goal = Goal(f"{metres:g} m {_side(turn)} in {in_s:g} s", at.frame, waypoint)
            return [Asked(session.add_constraints([waypoint]), action, (goal,))]
        case Turn(turn, in_s):
            frame, heading = at.frame + session.rig.frames_in(in_s), at.facing_rad + math.radians(turn)
            waypoint = Waypoint(frame, float(at.position_m[0]), float(at.position_m[2]), heading)
            goals = (
                Goal(f"face {_side(turn)} in {in_s:g} s", at.frame, Facing(frame, heading)),
                Goal("on the spot meanwhile", at.frame, waypoint),
            )
            return [Asked(session.add_constraints([waypoint]), action, goals)]
        case Reach():
            return [_reach(session, action, at)]


def _side(turn_deg: float) -> str:
    if turn_deg == 0:
        return "ahead"
    return f"{abs(turn_deg):g} degrees to the {'left' if turn_deg > 0 else 'right'}"


def _move(session: Session, action: Move, at: Here) -> Asked:
    angle = at.way_rad + math.radians(action.turn_deg)
    x, z = action.speed_mps * math.sin(angle), action.speed_mps * math.cos(angle)
    what = f"{action.speed_mps:g} m/s {_side(action.turn_deg)}" if action.speed_mps else "stop"
    pace = Pace(at.frame, at.frame + session.rig.frames_in(action.seconds), x, z)
    goal = Goal(f"{what} for {action.seconds:g} s", at.frame, pace)
    edit = session.set_velocity(x, z, seconds=action.seconds, keep_prompt=action.keep_prompt)
    return Asked(edit, action, (goal,))


def _circle(session: Session, action: Circle, at: Here) -> list[Asked]:
    first = at.frame + session.rig.frames_in(action.begins_s)
    positions = circle_m(action, at, session.rig.frame_rate_hz)
    label = f"circle of {action.radius_m:g} m at {action.speed_mps:g} m/s for {action.seconds:g} s"
    path = RootTrajectory(first, positions)
    return [
        Asked(session.set_prompt(action.text, frame=first), Say(action.text), scheduled_frame=first),
        Asked(session.add_constraints([path]), action, (Goal(label, at.frame, path),)),
    ]


def circle_m(action: Circle, at: Here, frame_rate_hz: int) -> NDArray[np.float32]:
    """(N, 2) x, z in metres of a circle to the left that begins at the character, accelerating from a stand."""
    seconds = np.arange(round(action.seconds * frame_rate_hz)) / frame_rate_hz
    ramp = np.minimum(seconds, _PATH_RAMP_S)
    metres = action.speed_mps * (seconds - ramp + ramp**2 / (2 * _PATH_RAMP_S))
    angle = metres / action.radius_m
    ahead, left = action.radius_m * np.sin(angle), action.radius_m * (1 - np.cos(angle))
    sine, cosine = math.sin(at.way_rad), math.cos(at.way_rad)
    x = at.position_m[0] + ahead * sine + left * cosine
    z = at.position_m[2] + ahead * cosine - left * sine
    return np.stack([x, z], axis=1).astype(np.float32)


def _reach(session: Session, action: Reach, at: Here) -> Asked:
    sine, cosine = math.sin(at.facing_rad), math.cos(at.facing_rad)
    place = [
        at.position_m[0] + action.ahead_m * sine + action.left_m * cosine,
        action.up_m,
        at.position_m[2] + action.ahead_m * cosine - action.left_m * sine,
    ]
    frame = at.frame + session.rig.frames_in(action.in_s)
    joints = (0, session.rig.index(action.joint))
    targets = JointTargets(frame, joints, np.array([at.position_m, place], np.float32))
    goal = Goal(f"{action.joint} {action.up_m:g} m up in {action.in_s:g} s", at.frame, targets)
    return Asked(session.add_constraints([targets]), action, (goal,))
