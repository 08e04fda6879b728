"""ReachWatch: measures how well constraints were met, and reports it when their last frame cannot change any more."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.kinematics import Posed
from motiongen_server.engine.session.residuals import Nearest, Residual, nearest_by_waypoint, nearest_frame
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import (
    Constraint,
    ConstraintReached,
    RigLayout,
    RootTrajectory,
    SessionKey,
    Waypoint,
)


@dataclass(slots=True)
class ReachWatch:
    """Measures the constraints of one session, each frame once, as frames are committed.

    measured_to: frames below it have been measured. partial: constraints of which only the first frames have been, with
    the errors there, as their rows may not be held later. nearest: constraints that may be met at one of several
    frames, with the frame that came nearest so far.
    """

    session: SessionKey
    measured_to: int = 0
    partial: list[tuple[Constraint, Residual]] = field(default_factory=list)
    nearest: list[tuple[Constraint, Nearest]] = field(default_factory=list)

    def is_due(self, conditions: Conditions, committed_to: int) -> bool:
        """Whether `reached` may report a constraint once the frames below committed_to are promised."""
        if committed_to <= self.measured_to:
            return False
        return any(_told_after(constraint) < committed_to for constraint in conditions.constraints)

    def reached(
        self, rig: RigLayout, conditions: Conditions, timeline: Timeline, committed_to: int
    ) -> list[tuple[Constraint, ConstraintReached]]:
        """The constraints whose last frame is newly below committed_to, in the order of their ends.

        One that may be met at several frames is reported as soon as the frame that it aims for is committed, if it was
        met by then.
        """
        begin, self.measured_to = self.measured_to, max(committed_to, self.measured_to)
        if not conditions.constraints or committed_to <= begin:
            return []
        seen = conditions.constraints_within(begin, committed_to)
        posed = Posed(rig, timeline.rows_between(begin, committed_to))
        told = [*self._ended(seen, posed, begin, committed_to), *self._met(seen, posed, begin)]
        told.sort(key=lambda each: each[0].last_frame)
        return told

    def _ended(
        self, seen: tuple[Constraint, ...], posed: Posed, begin: int, committed_to: int
    ) -> Iterator[tuple[Constraint, ConstraintReached]]:
        """Results of constraints that apply to all of their frames. posed: the frames from begin up to committed_to."""
        before, self.partial = self.partial, []
        for constraint in seen:
            if _is_of_any_frame(constraint):
                continue
            # By identity, not by id: a constraint that replaced another is measured anew.
            residual = next((errors for held, errors in before if held is constraint), None) or Residual()
            first, end = max(constraint.first_frame, begin), min(constraint.last_frame + 1, committed_to)
            residual.add(constraint, first, posed.part(first - begin, end - begin))
            if constraint.last_frame < committed_to:
                yield constraint, self._told(constraint, residual, constraint.last_frame)
            else:
                self.partial.append((constraint, residual))

    def _met(
        self, seen: tuple[Constraint, ...], posed: Posed, begin: int
    ) -> Iterator[tuple[Constraint, ConstraintReached]]:
        """Results of constraints that may be met at one of several frames. posed: as in `_ended`."""
        # By identity, as above; in a dictionary, since there may be hundreds.
        before, self.nearest = {id(held): nearest for held, nearest in self.nearest}, []
        for constraint, now in self._nearest(seen, posed, begin):
            held = before.get(id(constraint), now)
            best = now if now.excess < held.excess else held
            is_over = constraint.last_frame < self.measured_to
            if is_over or (_told_after(constraint) < self.measured_to and best.excess <= 1.0):
                yield constraint, self._told(constraint, best.residual, best.frame)
            else:
                self.nearest.append((constraint, best))

    def _nearest(self, seen: tuple[Constraint, ...], posed: Posed, begin: int) -> Iterator[tuple[Constraint, Nearest]]:
        """For each constraint that may be met at one of several frames, in order, the frame that comes nearest."""
        waypoints = [each for each in seen if isinstance(each, Waypoint) and each.span and each.heading is None]
        together = zip(waypoints, nearest_by_waypoint(waypoints, begin, posed), strict=True) if waypoints else ()
        by_waypoint = {id(waypoint): nearest for waypoint, nearest in together}
        for constraint in seen:
            if not _is_of_any_frame(constraint):
                continue
            nearest = by_waypoint.get(id(constraint))
            if nearest is None:
                first, end = max(constraint.first_frame, begin), min(constraint.last_frame + 1, self.measured_to)
                nearest = nearest_frame(constraint, first, posed.part(first - begin, end - begin))
            yield constraint, nearest

    def _told(self, constraint: Constraint, residual: Residual, frame: int) -> ConstraintReached:
        position, heading, rotation = residual.position_m, residual.heading_rad, residual.rotation_rad
        met, identifier = residual.is_within(constraint.tolerance), constraint.constraint_id
        return ConstraintReached(self.session, identifier, met, frame, residual.num_frames, position, heading, rotation)


def _is_of_any_frame(constraint: Constraint) -> bool:
    return not isinstance(constraint, RootTrajectory) and constraint.span is not None


def _told_after(constraint: Constraint) -> int:
    """The frame whose commitment allows a constraint to be reported."""
    if isinstance(constraint, RootTrajectory) or constraint.span is None:
        return constraint.last_frame
    return constraint.frame
