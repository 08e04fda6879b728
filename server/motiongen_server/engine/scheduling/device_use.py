"""DeviceUse: what an engine has taken of its device."""

from __future__ import annotations

from typing import NamedTuple


class DeviceUse(NamedTuple):
    """Seconds in calls of the runner since the start, the background's share left out.

    busy_s: as they were; spent_s: of the processor, by the threads of the engine, where that is counted. work_s: had
    all been as large as they are under a backlog, at the pace of late; what single calls took is no measure where the
    processor is taken away now and then: the few that it is taken from took more, and all others less.
    """

    work_s: float = 0.0
    busy_s: float = 0.0
    spent_s: float = 0.0

    def rates(self, before: DeviceUse, seconds: float) -> DeviceUse:
        """Of a second, since `before`, so many seconds ago."""
        return DeviceUse(*((now - then) / seconds for now, then in zip(self, before, strict=True)))

    def toward(self, other: DeviceUse, weight: float) -> DeviceUse:
        """The mean of both, in which the other has this weight."""
        return DeviceUse(*(mine + weight * (theirs - mine) for mine, theirs in zip(self, other, strict=True)))
