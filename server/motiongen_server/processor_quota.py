"""The CPU quota of this process's control group, such as a container has, and how much of it has been used."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

GROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")
_FIRST_VERSION = ("cpu.cfs_quota_us", "cpu.cfs_period_us")
_ACCOUNT = "cpuacct"


@dataclass(frozen=True)
class _Group:
    """folder: holds its quota. accounts: files that may say how much it has used, for version 1 or 2 of cgroups."""

    folder: Path
    accounts: tuple[Path, ...]

    @property
    def cores(self) -> float:
        """Its quota; infinity if it has none."""
        try:
            if (self.folder / "cpu.max").exists():
                quota, period = (self.folder / "cpu.max").read_text(encoding="ascii").split()
            else:
                quota, period = ((self.folder / name).read_text(encoding="ascii") for name in _FIRST_VERSION)
            return math.inf if quota == "max" or int(quota) <= 0 else int(quota) / int(period)
        except (OSError, ValueError, ZeroDivisionError):  # no such group, or it has no such files
            return math.inf


def quota_cores(groups: Path = GROUPS, membership: Path = MEMBERSHIP) -> float:
    """Cores that all processes of the control group together may use; infinity if there is no quota.

    The least quota counts, of this process's group and those above it. groups: where they are mounted, for version 1
    (cpu.cfs_quota_us) or version 2 (cpu.max); within a container that is its own mount.
    """
    return min((group.cores for group in _groups(groups, membership)), default=math.inf)


def quota_use(groups: Path = GROUPS, membership: Path = MEMBERSHIP) -> Callable[[], float] | None:
    """A function that returns how many seconds of its quota the limiting group has used, with all of its processes.

    A second of a quota of 1.5 cores is 1.5 seconds of CPU time. None if there is no quota, or its use is not reported.
    The function raises nothing; if the use can no longer be read, it returns the last value again.
    """
    group = min(_groups(groups, membership), key=lambda each: each.cores, default=None)
    if group is None or group.cores == math.inf:
        return None
    for account in group.accounts:
        if _used_s(account) is not None:
            return _Use(account, group.cores)
    return None


class _Use:
    def __init__(self, account: Path, cores: float) -> None:
        self._account, self._cores = account, cores
        self._last_s = 0.0

    def __call__(self) -> float:
        used_s = _used_s(self._account)
        if used_s is not None:
            self._last_s = used_s / self._cores
        return self._last_s


def _used_s(account: Path) -> float | None:
    """Seconds of CPU time; None if the file does not say."""
    try:
        text = account.read_text(encoding="ascii")
        if account.name == "cpu.stat":
            return int(dict(line.split(maxsplit=1) for line in text.splitlines())["usage_usec"]) / 1e6
        return int(text) / 1e9
    except (OSError, ValueError, KeyError):
        return None


def _groups(groups: Path, membership: Path) -> Iterator[_Group]:
    try:
        said = membership.read_text(encoding="utf-8", errors="surrogateescape")  # names may be any bytes
    except OSError:  # not Linux
        return
    lines = [line.split(":", 2) for line in said.split("\n") if line.count(":") >= 2]
    paths = {controller: path for _, controllers, path in lines for controller in controllers.split(",")}
    for _, controllers, path in lines:
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = groups / "cpu" if controllers else groups
        for folder in _with_those_above(mount, path):
            accounts = [folder / "cpu.stat", folder / "cpuacct.usage"]
            if controllers and paths.get(_ACCOUNT) == path:  # the same group, in a separate hierarchy of cpuacct
                accounts.append(groups / _ACCOUNT / folder.relative_to(mount) / "cpuacct.usage")
            yield _Group(folder, tuple(accounts))


def _with_those_above(mount: Path, path: str) -> Iterator[Path]:
    # A container may see its own group as the root, but its path as seen from outside.
    folder = mount / path.lstrip("/")
    yield from (mount, folder, *(above for above in folder.parents if above.is_relative_to(mount)))
