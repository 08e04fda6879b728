"""Plans a root path to sparse root goals, and adapts dense ones so that a person can follow them."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from motiongen_ardy.model.sampling.following import bounds, joined, limited, rounded
from motiongen_ardy.model.sampling.options import PlanOptions
from motiongen_ardy.model.sampling.steering import RootState, brought_onto, steer, turned_on_the_spot, wrapped

# Goals no further apart than this lead the model by themselves.
DENSE_FRAMES = 10
# Below this speed nobody turns to face the way; at a larger angle to the facing, people walk backwards or sideways.
_WALKS_M_S, _ASIDE_RAD = 0.3, 1.0
_CHORD_FRAMES = 5
_NEAR_M, _NEAR_M_S, _NEAR_RAD = 0.015, 0.35, 0.1


@dataclass
class RootGoals:
    """Root goals by absolute frame. ground: (2), metres; heading: radians.

    planned, faced: frames whose ground position, or heading, was not asked for itself.
    """

    ground: dict[int, np.ndarray] = field(default_factory=dict)
    heading: dict[int, float] = field(default_factory=dict)
    planned: set[int] = field(default_factory=set)
    faced: set[int] = field(default_factory=set)


@dataclass(frozen=True)
class PlanSpan:
    """The frames that are planned, from first_frame on.

    Path points from told_frame on are not given to the model; goals from end_frame on are ignored.
    """

    first_frame: int
    told_frame: int
    end_frame: int
    fps: int


def plan_root(asked: RootGoals, state: RootState, span: PlanSpan, options: PlanOptions) -> RootGoals:
    """The goals to give to the model: those asked for, as nearly as a person can reach them, and a path between them.

    state: the root at the frame before the span. Goals before the span stay as they are.
    """
    plan = _Plan(asked, state, span, options)
    for run in runs([frame for frame in sorted(asked.ground) if span.first_frame <= frame < span.end_frame]):
        if run[0] - plan.frame > DENSE_FRAMES or len(run) == 1:
            plan.walk_to(run[0])
        if len(run) > 1:
            plan.follow(run)
    plan.turn()
    return plan.goals


def runs(frames: Sequence[int]) -> Iterator[list[int]]:
    """Frames in order; three or more that are close enough to lead by themselves form one run, others stand alone."""
    first = 0
    for index in range(1, len(frames) + 1):
        if index == len(frames) or frames[index] - frames[index - 1] > DENSE_FRAMES:
            run = list(frames[first:index])
            yield from [run] if len(run) > 2 else [[frame] for frame in run]
            first = index


class _Plan:
    """A plan under construction: how far it has come, and the root's state there."""

    def __init__(self, asked: RootGoals, state: RootState, span: PlanSpan, options: PlanOptions) -> None:
        self.goals = RootGoals(dict(asked.ground), dict(asked.heading), set(asked.planned), set(asked.faced))
        self.asked, self.state, self.span, self.options = asked, state, span, options
        self.start, self.frame = state, span.first_frame - 1
        self.turned: set[int] = set()

    def walk_to(self, goal_frame: int) -> None:
        """Plan a path from where the root is to a goal."""
        count, fps = goal_frame - self.frame, self.span.fps
        goal, heading = self.asked.ground[goal_frame], self.asked.heading.get(goal_frame)
        path = steer(self.state, goal, heading, count, fps, self.options)
        path = brought_onto(path, goal, heading, fps, self.options)
        others = [frame for frame in self.asked.heading if self.frame < frame < goal_frame]
        for frame in range(goal_frame - self.options.stride_frames, self.frame + 1, -self.options.stride_frames):
            if frame < self.span.told_frame:
                self.goals.ground[frame] = path.ground[frame - self.frame - 1]
                self.goals.planned.add(frame)
                if not others:
                    self.goals.heading[frame] = float(path.heading[frame - self.frame - 1])
                    self.goals.faced.add(frame)
        self.goals.ground[goal_frame] = path.ground[-1]
        if heading is not None or (not others and goal_frame - self.frame > 1 and goal_frame < self.span.told_frame):
            self.goals.heading[goal_frame] = float(path.heading[-1])
        self.turned.add(goal_frame)
        before = path.ground[-2] if count > 1 else self.state.position
        self.state = RootState(path.ground[-1], (path.ground[-1] - before) * fps, float(path.heading[-1]))
        self.frame = goal_frame

    def follow(self, run: Sequence[int]) -> None:
        """Follow dense goals: join them without a jolt, and round bends that are too sharp."""
        frames, fps = np.array(run), self.span.fps
        ground = np.stack([self.asked.ground[frame] for frame in run])
        every = np.arange(frames[0], frames[-1] + 1)
        path = np.stack([np.interp(every, frames, ground[:, axis]) for axis in (0, 1)], axis=1)
        if len(every) == len(frames):
            path = rounded(limited(path, self.state.position, fps), fps)
        velocity = (path[1] - path[0]) * fps
        away = frames[0] - self.frame
        offset = self.state.position - (path[0] - velocity * away / fps)
        drift = self.state.velocity - velocity
        near = np.hypot(*offset) < _NEAR_M and np.hypot(*drift) < _NEAR_M_S
        if not near and not self.asked.planned.issuperset(run):
            # If the first position has been walked to (away is 0), the root is there, or as near as it could get.
            ahead = np.repeat(path[:1], away - 1, axis=0) if away else self.state.position[None]
            path = np.concatenate([ahead, path[0 if away else 1 :]])
            before = 0 if away else 1
            path[before:] = joined(path[before:], offset, drift, *bounds(self.options), fps)
            path = path[max(0, away - 1) :]
        self.goals.ground.update(zip(run, path[frames - frames[0]], strict=True))
        facing = self.state.heading
        if not any(run[0] <= frame <= run[-1] for frame in self.asked.heading):
            facing = self._face_along(run[0], path)
        self.state = RootState(path[-1], (path[-1] - path[-2]) * fps, facing)
        self.frame = run[-1]

    def _face_along(self, first: int, path: np.ndarray) -> float:
        """Face along a path (T, 2) from frame `first` on, or at the present angle to it if the root is walking
        backwards or sideways. Returns the heading at its end.
        """
        fps, state = self.span.fps, self.state
        off = 0.0
        if np.hypot(*state.velocity) > _WALKS_M_S:
            off = wrapped(state.heading - math.atan2(*state.velocity))
            off = off if abs(off) > _ASIDE_RAD else 0.0
        index = np.arange(len(path))
        ahead = path[np.minimum(index + _CHORD_FRAMES, len(path) - 1)] - path[np.maximum(index - _CHORD_FRAMES, 0)]
        walks = np.hypot(*ahead.T) > _WALKS_M_S * 2 * _CHORD_FRAMES / fps
        along = np.arctan2(*ahead[walks].T) + off
        facings = np.unwrap(np.append(state.heading, along))
        wanted = facings[np.cumsum(walks)]  # the last known direction: a character that stops keeps facing that way
        turn = np.array([state.heading - wanted[0]])
        rate = 0.8 * self.options.turn_rate_rad_s
        turned = joined(wanted[:, None], turn, np.zeros(1), 12.0, rate, fps)[:, 0]
        for frame in range(first + len(path) - 1, first, -self.options.stride_frames):
            if frame < self.span.told_frame:
                self.goals.heading[frame] = float(turned[frame - first])
                self.goals.faced.add(frame)
        return float(turned[-1])

    def turn(self) -> None:
        """Adapt headings that no path has dealt with, so that a body can follow them."""
        span = self.span
        left = [f for f in self.asked.heading if span.first_frame <= f < span.end_frame and f not in self.turned]
        for run in runs(sorted(left)):
            known = [frame for frame in self.goals.heading if frame < run[0]]
            known = [frame for frame in known if frame >= span.first_frame]
            frame = max(known, default=span.first_frame - 1)
            facing = self.goals.heading[frame] if known else self.start.heading
            if len(run) == 1:
                self._turn_to(run[0], frame, facing)
            elif not self.asked.faced.issuperset(run):
                self._follow_heading(run, frame, facing)

    def _turn_to(self, goal_frame: int, frame: int, facing: float) -> None:
        count = goal_frame - frame
        turned = turned_on_the_spot(facing, self.asked.heading[goal_frame], count, self.span.fps, self.options)
        for between in range(goal_frame, frame + 1, -self.options.stride_frames):
            if between < self.span.told_frame or between == goal_frame:
                self.goals.heading[between] = float(turned[between - frame - 1])
                if between != goal_frame:
                    self.goals.faced.add(between)

    def _follow_heading(self, run: Sequence[int], frame: int, facing: float) -> None:
        values = np.unwrap([self.asked.heading[one] for one in run])
        off, away = wrapped(facing - float(values[0])), run[0] - frame
        if abs(off) < _NEAR_RAD:
            return
        every = np.interp(np.arange(run[0], run[-1] + 1), run, values)[:, None]
        every = np.concatenate([np.repeat(every[:1], away - 1, axis=0), every])
        rate = 0.8 * self.options.turn_rate_rad_s
        turned = joined(every, np.array([off]), np.zeros(1), 12.0, rate, self.span.fps)[away - 1 :, 0]
        for one in run:
            self.goals.heading[one] = float(turned[one - run[0]])


def without_steering(asked: RootGoals, first_frame: int, needed: Container[int] = ()) -> RootGoals:
    """Goals without those of a velocity, where a client asks for a position: the root walks there instead.

    needed: frames with goals for other joints, which are relative to the root: these keep the root's position.
    """
    own: Mapping[int, np.ndarray] = {f: g for f, g in asked.ground.items() if f not in asked.planned}
    last = max((frame for frame in own if frame >= first_frame), default=None)
    if last is None or not asked.planned:
        return asked
    led = {frame for frame in asked.planned if frame <= last}
    gone, turned = {frame for frame in led if frame not in needed}, led & asked.faced
    return RootGoals(
        {frame: ground for frame, ground in asked.ground.items() if frame not in gone},
        {frame: heading for frame, heading in asked.heading.items() if frame not in turned},
        asked.planned - gone,
        asked.faced - turned,
    )
