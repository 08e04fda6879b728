"""Aiming: how a window is told of constraints with spans, of far places, and of joint targets with a free root."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motiongen_ardy.locomotion.velocity import RootState, lead_by
from motiongen_ardy.locomotion.way import WALK_M_S
from motiongen_server.engine.session.course import Course, place_given
from motiongen_server.engine.session.kinematics import Posed
from motiongen_server.engine.session.placing import Anchor, goal_of, root_for
from motiongen_server.engine.session.residuals import nearest_frame
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import (
    VELOCITY_ID,
    Constraint,
    JointTargets,
    RigLayout,
    RootTrajectory,
    Waypoint,
)

FASTEST_LEAD_M_S = 3.0


@dataclass(frozen=True, slots=True)
class Aiming:
    """For one window. window: the frames that it sees, from its first new one on. root_before: the root's state."""

    rig: RigLayout
    fps: int
    timeline: Timeline
    window: range
    root_before: Callable[[int], RootState]

    def aimed(self, constraints: Iterable[Constraint]) -> tuple[Constraint, ...]:
        """The constraints, each with the frame that it is aimed at now; without those that are met already.

        One that may be met later than at its frame, which has passed, is aimed at the next frame at which a person can
        be there.
        """
        found: list[Constraint] = []
        root: RootState | None = None
        first, start = self.timeline.first, self.window.start
        posed = Posed(self.rig, self.timeline.rows_between(first, start))
        for item in constraints:
            if isinstance(item, RootTrajectory) or item.span is None or item.frame >= start:
                found.append(item)
                continue
            begin = max(item.first_frame, first)
            if begin < start and nearest_frame(item, begin, posed.part(begin - first, start - first)).excess <= 1.0:
                continue  # already met
            root = root or self.root_before(start)
            anchor = Anchor(start, root, self.fps, self.rig, item.span.last)
            found.append(replace(item, frame=anchor.first_possible(*goal_of(item, root, self.rig))))
        return tuple(found)

    def lead(self, constraints: Iterable[Constraint], end: int) -> RootTrajectory | None:
        """A path, up to frame `end`, to the first of the places that are led to and lie beyond the window."""
        far = [
            item
            for item in constraints
            if not isinstance(item, RootTrajectory)
            and item.span is not None
            and item.span.is_led
            and item.frame >= self.window.stop
        ]
        if not far:
            return None
        goal, start = min(far, key=lambda item: item.frame), self.window.start
        root = self.root_before(start)
        x, z, _ = goal_of(goal, root, self.rig)
        away = math.hypot(x - root.x, z - root.z)
        # Half a second of the time left is needed for turning and stopping.
        left_s = max((goal.frame - start) / self.fps - 0.5, 0.5)
        speed = min(max(away / left_s, WALK_M_S), FASTEST_LEAD_M_S)
        asked = (x - root.x) / max(away, 1e-6) * speed, (z - root.z) / max(away, 1e-6) * speed
        way = lead_by(asked, None, end - start, end - start, root, self.fps)
        if away < speed * (end - start) / self.fps or way is None:
            return None
        heading = None if way.heading is None else way.heading.astype(np.float32)
        return RootTrajectory(VELOCITY_ID, start, way.ground.astype(np.float32), heading)

    def free_roots(self, constraints: Sequence[Constraint], lead: RootTrajectory | None = None) -> tuple[Waypoint, ...]:
        """A place of the root for each joint target that leaves it free, if nothing else gives one at that frame.

        It is where the character is expected to go, moved to where the joints can reach their places. lead: the path of
        a velocity or to a far place; while it leads, the joints reach for their places from the path.
        """
        free = [item for item in constraints if isinstance(item, JointTargets) and 0 not in item.joints]
        if not free:
            return ()
        given = {item.frame for item in constraints if not isinstance(item, RootTrajectory) and place_given(item)}
        paths = [item for item in constraints if isinstance(item, RootTrajectory)]
        course = Course(self.window, self.fps, self.root_before(self.window.start), lead, constraints)
        found = []
        for item in sorted(free, key=lambda item: item.frame):
            frame = item.frame
            if frame in given or any(path.first_frame <= frame <= path.last_frame for path in paths):
                continue
            x, z = course.at(frame)
            if not course.is_led_at(frame):  # a single place off the lead would make the root jump aside and back
                x, z = root_for(item, x, z, self.rig)
            course.add(frame, x, z)
            found.append(Waypoint(VELOCITY_ID, frame, x, z))
        return tuple(found)
