"""What part of the processor the control group of this process may use, as containers are given it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

GROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")


def quota_cores(groups: Path = GROUPS, membership: Path = MEMBERSHIP) -> float:
    """Cores that all processes of the group together may use, infinity where nobody has said.

    Of the group that this process is in and of those above it, the least counts. groups: where they are mounted, of the
    first version (cpu.cfs_quota_us) or of the second (cpu.max); inside of a container that is its own.
    """
    return min((_cores(folder) for folder in _folders(groups, membership)), default=math.inf)


def _folders(groups: Path, membership: Path) -> Iterator[Path]:
    try:
        lines = membership.read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = groups / "cpu" if controllers else groups
        folder = mount / path.lstrip("/")
        # A container may see its own group as the root and still be told its path outside.
        yield from (mount, folder, *(above for above in folder.parents if above.is_relative_to(mount)))


def _cores(folder: Path) -> float:
    try:
        if (folder / "cpu.max").exists():
            quota, period = (folder / "cpu.max").read_text(encoding="ascii").split()
        else:
            quota, period = ((folder / name).read_text(encoding="ascii") for name in _FIRST_VERSION)
        return math.inf if quota == "max" or int(quota) <= 0 else int(quota) / int(period)
    except (OSError, ValueError):  # no such group, or none that says so
        return math.inf


_FIRST_VERSION = ("cpu.cfs_quota_us", "cpu.cfs_period_us")
