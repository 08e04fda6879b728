"""Degradation under a load that the test sets."""

from __future__ import annotations

from collections.abc import Mapping

from motiongen_server.engine.scheduling.degradation import Degradation, Demand
from motiongen_server.engine.scheduling.levels import levels_of
from motiongen_server.engine.types import Priority
from tests.server.engine.fakes import FACTS

LEVELS = levels_of(FACTS)
EVERY_S = 0.25
ALL = dict.fromkeys(Priority, 10)


class Day:
    """A Degradation that is updated four times a second, under a load and with a share of windows late."""

    def __init__(self, present: Mapping[Priority, int] | None = None) -> None:
        self.now = 0.0
        self.present = ALL if present is None else present
        self.degradation = Degradation(LEVELS, self.now)
        self.shed = 0

    def pass_time(
        self, seconds: float, load: float = 0.3, late: float = 0.0, demand: Demand | None = None
    ) -> list[Priority]:
        """Returns the classes whose level changed meanwhile, in order."""
        moved: list[Priority] = []
        for _ in range(round(seconds / EVERY_S)):
            self.now += EVERY_S
            self.degradation.note_windows(self.now, 100, round(100 * late))
            moved += self.degradation.update(self.now, load, self.present, demand=demand)
            self.shed += self.degradation.shed
        return moved

    def levels(self) -> list[int]:
        return [self.degradation.depth(priority) for priority in Priority]
