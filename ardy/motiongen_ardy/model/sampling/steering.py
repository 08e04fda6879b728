"""How a person walks to a position in a given time: bounded speed, acceleration and turning, turning first."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from motiongen_ardy.model.sampling.options import PlanOptions

# A goal nearer than this is reached by a step sideways or backwards, without turning.
STEP_M = 0.5
# With time to spare, a character walks at this speed and then waits, instead of creeping.
STROLL_M_S = 0.6
SHORTEST_TURN_S = 0.6
# A character that is not running already is not asked to run.
FASTEST_M_S = 4.0
_SPEED_MARGIN = 1.15
_BRAKING_M_S2 = 1.5


class RootState(NamedTuple):
    """The root at one frame: ground position (2) in metres, velocity (2) in m/s, heading in radians."""

    position: np.ndarray
    velocity: np.ndarray
    heading: float


class Path(NamedTuple):
    """The root at consecutive frames. ground: (T, 2) metres; heading: (T) radians, not wrapped."""

    ground: np.ndarray
    heading: np.ndarray


def wrapped(angle: float) -> float:
    """An angle in -pi..pi."""
    return math.remainder(angle, math.tau)


def smoothstep(share: np.ndarray) -> np.ndarray:
    """3 s^2 - 2 s^3, constant outside 0..1: flat at both ends, greatest slope 1.5, greatest second derivative 6."""
    held = np.clip(share, 0.0, 1.0)
    smooth: np.ndarray = held * held * (3.0 - 2.0 * held)
    return smooth


def steer(
    start: RootState, goal: np.ndarray, heading: float | None, num_frames: int, fps: int, options: PlanOptions
) -> Path:
    """The num_frames frames after `start`, the last of which is to reach a goal (2).

    Faces along the way and, if a heading is given, turns to it at the end. If the goal is out of reach, the last frame
    misses it.
    """
    x, z = (float(value) for value in start.position)
    speed_x, speed_z = (float(value) for value in start.velocity)
    goal_x, goal_z = (float(value) for value in goal)
    facing, dt = start.heading, 1.0 / fps
    fastest = min(FASTEST_M_S, max(options.speed_m_s, _SPEED_MARGIN * math.hypot(speed_x, speed_z)))
    walks = math.hypot(goal_x - x, goal_z - z) > STEP_M
    turn_rate = 0.0
    ground, headings = np.empty((num_frames, 2)), np.empty(num_frames)
    for frame in range(num_frames):
        left_s = (num_frames - frame) * dt
        away_x, away_z = goal_x - x, goal_z - z
        distance = math.hypot(away_x, away_z)
        wanted, share = facing, 1.0
        if walks and distance > 0.15:
            off = wrapped(math.atan2(away_x, away_z) - facing)
            wanted, share = facing + off, max(0.0, math.cos(0.85 * off))
        if heading is not None:
            off = wrapped(heading - facing)
            if left_s <= max(0.6, abs(off) / (0.6 * options.turn_rate_rad_s)) + 0.1:
                wanted, share = facing + off, 1.0
        speed = distance / left_s
        if speed < STROLL_M_S:  # there is time: stroll, and wait at the goal
            speed = min(STROLL_M_S, max(speed, math.sqrt(2.0 * _BRAKING_M_S2 * distance) - _BRAKING_M_S2 * dt))
        else:  # make up for the time lost in starting and turning
            speed *= 1.1 if left_s > 0.5 else 1.0
        speed = min(speed, fastest) * share
        scale = speed / max(distance, 1e-6)
        change_x, change_z = away_x * scale - speed_x, away_z * scale - speed_z
        change = math.hypot(change_x, change_z)
        most = options.acceleration_m_s2 * dt
        held = min(1.0, most / max(change, 1e-9))
        speed_x, speed_z = speed_x + change_x * held, speed_z + change_z * held
        x, z = x + speed_x * dt, z + speed_z * dt
        asked = max(-options.turn_rate_rad_s, min(options.turn_rate_rad_s, 5.0 * (wanted - facing)))
        turn_rate += max(-16.0 * dt, min(16.0 * dt, asked - turn_rate))
        facing += turn_rate * dt
        ground[frame] = x, z
        headings[frame] = facing
    if heading is not None and not walks:
        headings = turned_on_the_spot(start.heading, heading, num_frames, fps, options)
    return Path(ground, headings)


def turned_on_the_spot(facing: float, heading: float, num_frames: int, fps: int, options: PlanOptions) -> np.ndarray:
    """Headings (num_frames) from `facing` to `heading`, reached at the last one, as fast as steps allow."""
    off, seconds = wrapped(heading - facing), num_frames / fps
    takes = min(seconds, max(SHORTEST_TURN_S, abs(off) / options.spot_turn_rad_s))
    most = options.turn_rate_rad_s * seconds / 1.5
    share = 1.0 - np.arange(num_frames - 1, -1, -1) / (takes * fps)
    turned: np.ndarray = facing + max(-most, min(most, off)) * smoothstep(share)
    return turned


def brought_onto(path: Path, goal: np.ndarray, heading: float | None, fps: int, options: PlanOptions) -> Path:
    """A path whose end is moved onto a goal (2), and turned to a heading, as far as possible without a jolt."""
    count = len(path.ground)
    seconds = count / fps
    share = smoothstep(np.arange(1, count + 1) / count)
    missing = goal - path.ground[-1]
    most = min(options.acceleration_m_s2 * seconds**2 / 6.0, 0.5 * seconds / 1.5)
    length = float(np.hypot(*missing))
    ground = path.ground + share[:, None] * missing * min(1.0, most / max(length, 1e-9))
    headings = path.heading
    if heading is not None:
        off = wrapped(heading - float(path.heading[-1]))
        turn = max(-0.5 * options.turn_rate_rad_s * seconds, min(0.5 * options.turn_rate_rad_s * seconds, off))
        headings = headings + share * turn
    return Path(ground, headings)
