"""A server's processes: which there are, what memory they take and how much of the processor they have used.

Those below the gateway are not only its children: with several engines on processors, its child is what they are forked
from.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

MIB = 1 << 20


@dataclass(frozen=True)
class Memory:
    """Of one process, bytes. proportional: its part of what several map (Pss), so these may be added up; own: what no
    other maps.
    """

    resident: int
    proportional: int
    own: int


def below(gateway: psutil.Process) -> list[psutil.Process]:
    """Its engine processes, and what they are forked from; none that has ended."""
    return [process for process in gateway.children(recursive=True) if process.status() != psutil.STATUS_ZOMBIE]


def engines_of(gateway: psutil.Process) -> list[psutil.Process]:
    """Of those below, the ones that nothing is forked from."""
    return [process for process in below(gateway) if not process.children()]


def memory_of(pid: int) -> Memory:
    """From `/proc/PID/smaps_rollup`. Raises FileNotFoundError where there is no such process."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()[1:]
    kib = {line.split(":")[0]: int(line.split()[1]) for line in lines}
    own = kib["Private_Clean"] + kib["Private_Dirty"]
    return Memory(1024 * kib["Rss"], 1024 * kib["Pss"], 1024 * own)


def memory_mib(gateway: psutil.Process) -> list[float]:
    """Each process's part of the memory of all, MiB, the gateway first."""
    return [memory_of(process.pid).proportional / MIB for process in (gateway, *below(gateway))]


def processor_s(processes: Iterable[psutil.Process]) -> float:
    """Used so far by all of them. One that has ended meanwhile does not count."""
    seconds = 0.0
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            seconds += sum(process.cpu_times()[:2])
    return seconds
