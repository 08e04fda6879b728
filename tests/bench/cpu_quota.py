"""CpuQuota: limits processes to some number of cores, with a Linux control group of version 1 or 2.

It uses the kernel's bandwidth control, as containers do: in every period of 100 ms, all threads together may compute
for the quota, and then stand still until the next period. Creating a group needs root.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

PERIOD_US = 100_000
_ROOT = Path("/sys/fs/cgroup")
_GONE_WITHIN_S = 5.0


class NoQuota(RuntimeError):
    """No group with a quota can be created here; the message says why."""


class CpuQuota:
    """A group that may use so many cores. Use it as `with CpuQuota(0.7) as quota`; it must be empty at the end.

    shares: its weight against other groups that compete for the CPU; 1024 is the weight of a single process.
    """

    def __init__(self, cores: float, shares: int = 1024, root: Path = _ROOT) -> None:
        """root: where the control groups are mounted."""
        if not 0.01 <= cores <= (os.cpu_count() or 1):
            raise ValueError(f"a quota of {cores} cores was given; allowed is 0.01 to {os.cpu_count()}")
        self.cores = cores
        self._is_second = "cpu" in _words(root / "cgroup.controllers")
        self._parent = root if self._is_second else root / "cpu"
        self._group = self._parent / f"motiongen-quota-{os.getpid()}-{time.monotonic_ns()}"
        # In version 1, CPU usage is accounted in a separate hierarchy; containers get both.
        apart = root / "cpuacct"
        is_apart = not self._is_second and apart.is_dir() and not apart.samefile(self._parent)
        self._accounts = [apart / self._group.name] if is_apart else []
        self._shares = shares

    def __enter__(self) -> CpuQuota:
        """Raises NoQuota."""
        quota_us = round(self.cores * PERIOD_US)
        try:
            if self._is_second and "cpu" not in _words(self._parent / "cgroup.subtree_control"):
                (self._parent / "cgroup.subtree_control").write_text("+cpu")
            for group in (self._group, *self._accounts):
                group.mkdir()
            if self._is_second:
                (self._group / "cpu.max").write_text(f"{quota_us} {PERIOD_US}")
                (self._group / "cpu.weight").write_text(f"{max(1, self._shares * 100 // 1024)}")
            else:
                (self._group / "cpu.cfs_period_us").write_text(f"{PERIOD_US}")
                (self._group / "cpu.cfs_quota_us").write_text(f"{quota_us}")
                (self._group / "cpu.shares").write_text(f"{self._shares}")
        except OSError as error:
            for group in (self._group, *self._accounts):
                with contextlib.suppress(OSError):
                    group.rmdir()
            raise NoQuota(f"cannot create a control group in {self._parent}: {error}; run as root on Linux") from error
        return self

    def __exit__(self, *_: object) -> None:
        """Raises OSError if processes remain in the group."""
        give_up_at = time.monotonic() + _GONE_WITHIN_S
        while _words(self._group / "cgroup.procs") and time.monotonic() < give_up_at:
            time.sleep(0.05)
        for group in (self._group, *self._accounts):
            group.rmdir()

    @contextlib.contextmanager
    def joined(self) -> Iterator[None]:
        """Processes that this process starts in this context stay in the group; this process itself leaves it again."""
        groups = (self._group, *self._accounts)
        homes = [self._home(group.parent) for group in groups]
        try:
            for group in groups:
                (group / "cgroup.procs").write_text(f"{os.getpid()}")
            yield
        finally:
            for home in homes:
                (home / "cgroup.procs").write_text(f"{os.getpid()}")

    def _home(self, mount: Path) -> Path:
        """The group of this process in the hierarchy mounted at `mount`."""
        for line in Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines():
            _, controllers, path = line.split(":", 2)
            if (controllers == "") if self._is_second else (mount.name in controllers.split(",")):
                return mount / path.lstrip("/")
        return mount


def _words(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").split()
    except OSError:
        return []
