"""A server's processes: which there are, how much memory they take, and how much CPU time they have used.

Not all are children of the gateway: with several engines on CPUs, the gateway's child is the process that they are
forked from.
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
    """The memory of one process, bytes. proportional: with its share of what several processes map (Pss), so that these
    can be added up; own: what no other process maps.
    """

    resident: int
    proportional: int
    own: int


def below(gateway: psutil.Process) -> list[psutil.Process]:
    """The gateway's engine processes, and the process that they are forked from; none that has ended."""
    return [process for process in gateway.children(recursive=True) if process.status() != psutil.STATUS_ZOMBIE]


def engines_of(gateway: psutil.Process) -> list[psutil.Process]:
    """The processes below the gateway that nothing is forked from."""
    return [process for process in below(gateway) if not process.children()]


def memory_of(pid: int) -> Memory:
    """From `/proc/PID/smaps_rollup`. Raises FileNotFoundError if there is no such process."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()[1:]
    kib = {line.split(":")[0]: int(line.split()[1]) for line in lines}
    own = kib["Private_Clean"] + kib["Private_Dirty"]
    return Memory(1024 * kib["Rss"], 1024 * kib["Pss"], 1024 * own)


def memory_mib(gateway: psutil.Process) -> list[float]:
    """The Pss of each process, MiB, the gateway first."""
    return [memory_of(process.pid).proportional / MIB for process in (gateway, *below(gateway))]


def processor_s(processes: Iterable[psutil.Process]) -> float:
    """CPU seconds used so far by all of them. A process that has ended does not count."""
    seconds = 0.0
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            seconds += sum(process.cpu_times()[:2])
    return seconds
