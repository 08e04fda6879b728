"""What part of the processor the control group of this process may use, and has used, as containers are given it."""

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
    """folder: where its quota is. accounts: files that may say what it has used, of the first version or the second."""

    folder: Path
    accounts: tuple[Path, ...]

    @property
    def cores(self) -> float:
        """Its quota, infinity where it has none."""
        try:
            if (self.folder / "cpu.max").exists():
                quota, period = (self.folder / "cpu.max").read_text(encoding="ascii").split()
            else:
                quota, period = ((self.folder / name).read_text(encoding="ascii") for name in _FIRST_VERSION)
            return math.inf if quota == "max" or int(quota) <= 0 else int(quota) / int(period)
        except (OSError, ValueError, ZeroDivisionError):  # no such group, or none that says so
            return math.inf


def quota_cores(groups: Path = GROUPS, membership: Path = MEMBERSHIP) -> float:
    """Cores that all processes of the group together may use, infinity where nobody has said.

    Of the group that this process is in and of those above it, the least counts. groups: where they are mounted, of the
    first version (cpu.cfs_quota_us) or of the second (cpu.max); inside of a container that is its own.
    """
    return min((group.cores for group in _groups(groups, membership)), default=math.inf)


def quota_use(groups: Path = GROUPS, membership: Path = MEMBERSHIP) -> Callable[[], float] | None:
    """Tells how many seconds of its quota the group whose quota counts has used so far, by all of its processes.

    A second is the quota's: of 1.5 cores, 1.5 seconds of processor time. None where there is no quota, or no account of
    what is used. The call raises nothing; once it can tell no more, it says again what it said last.
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
    """Seconds of processor time, None where the file does not say."""
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
            if controllers and paths.get(_ACCOUNT) == path:  # the same group, in a hierarchy of accounts alone
                accounts.append(groups / _ACCOUNT / folder.relative_to(mount) / "cpuacct.usage")
            yield _Group(folder, tuple(accounts))


def _with_those_above(mount: Path, path: str) -> Iterator[Path]:
    # A container may see its own group as the root and still be told its path outside.
    folder = mount / path.lstrip("/")
    yield from (mount, folder, *(above for above in folder.parents if above.is_relative_to(mount)))
