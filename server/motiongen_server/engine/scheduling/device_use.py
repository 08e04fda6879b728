"""DeviceUse: how much of its device an engine has used."""

from __future__ import annotations

from typing import NamedTuple


class DeviceUse(NamedTuple):
    """Seconds in calls of the runner since the start, without the background's share.

    busy_s: as measured. spent_s: processor time of the engine's threads, where that is counted. work_s: what the calls
    would have taken at the sizes of a backlog and the current pace; the times of single calls are no measure if the
    processor is taken away now and then, as the few calls that this hits take more and all others less.
    """

    work_s: float = 0.0
    busy_s: float = 0.0
    spent_s: float = 0.0

    def rates(self, before: DeviceUse, seconds: float) -> DeviceUse:
        """The use per second since `before`, which was this many seconds ago."""
        return DeviceUse(*((now - then) / seconds for now, then in zip(self, before, strict=True)))

    def toward(self, other: DeviceUse, weight: float) -> DeviceUse:
        """The weighted mean of both, in which the other has this weight."""
        return DeviceUse(*(mine + weight * (theirs - mine) for mine, theirs in zip(self, other, strict=True)))
