"""ReachWatch: what became of constraints, told when the last frame that they ask for cannot change any more."""

from __future__ import annotations

from dataclasses import dataclass, field

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.residuals import Residual
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import Constraint, ConstraintReached, RigLayout, SessionKey


@dataclass(slots=True)
class ReachWatch:
    """Measures the constraints of one session, each frame once, as frames are committed.

    measured_to: frames below it have been measured. partial: the constraints of which only the first frames have been,
    with the errors there: later their rows may not be held any more.
    """

    session: SessionKey
    measured_to: int = 0
    partial: list[tuple[Constraint, Residual]] = field(default_factory=list)

    def reached(
        self, rig: RigLayout, conditions: Conditions, timeline: Timeline, committed_to: int
    ) -> list[ConstraintReached]:
        """The constraints whose last frame is below committed_to and was not before, in the order of their ends."""
        begin, self.measured_to = self.measured_to, max(committed_to, self.measured_to)
        if not conditions.constraints or committed_to <= begin:
            return []
        done: list[tuple[Constraint, Residual]] = []
        before, self.partial = self.partial, []
        for constraint in conditions.constraints_within(begin, committed_to):
            # By identity, not by id: one that took the place of another is measured anew.
            residual = next((errors for held, errors in before if held is constraint), None) or Residual()
            first, end = max(constraint.first_frame, begin), min(constraint.last_frame + 1, committed_to)
            residual.add(rig, constraint, first, timeline.rows_between(first, end))
            (done if constraint.last_frame < committed_to else self.partial).append((constraint, residual))
        done.sort(key=lambda each: each[0].last_frame)
        return [self._told(constraint, residual) for constraint, residual in done]

    def _told(self, constraint: Constraint, residual: Residual) -> ConstraintReached:
        position, heading, rotation = residual.position_m, residual.heading_rad, residual.rotation_rad
        tolerance = constraint.tolerance
        met = all(
            deviation is None or deviation.worst <= most
            for deviation, most in (
                (position, tolerance.position_m),
                (heading, tolerance.angle_rad),
                (rotation, tolerance.angle_rad),
            )
        )
        identifier, frame = constraint.constraint_id, constraint.last_frame
        return ConstraintReached(self.session, identifier, met, frame, residual.num_frames, position, heading, rotation)
