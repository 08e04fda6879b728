"""Facts about a measurement: machine, versions, commit."""

from __future__ import annotations

import os
import platform
import subprocess
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from motiongen_tools.bench.machine import cores, installed, processor

ROOT = Path(__file__).resolve().parents[2]


def machine_facts() -> dict[str, str]:
    """Name -> value, to be printed with the figures."""
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": commit(),
        "processor": processor(),
        "cores": cores(),
        "load before": f"{os.getloadavg()[0]:.2f} (1 minute)",
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        **{name: installed(name) for name in ("torch", "grpcio", "protobuf", "numpy")},
    }


def commit() -> str:
    """The commit of the checkout, marked if files differ from it."""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    try:
        return git("rev-parse", "--short=12", "HEAD") + (" with changes" if git("status", "--porcelain") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def busy_share() -> Callable[[], float]:
    """Returns a function that gives the share of all cores that others have used since; 0 if the system does not say.

    Others are all processes but this one and those that it started and has waited for.
    """
    started_s, ours_s, all_s = time.monotonic(), _ours_s(), _busy_s()

    def share() -> float:
        if all_s is None or (now_s := _busy_s()) is None:
            return 0.0
        others_s = now_s - all_s - (_ours_s() - ours_s)
        return max(0.0, others_s / ((time.monotonic() - started_s) * (os.cpu_count() or 1)))

    return share


def _ours_s() -> float:
    """CPU seconds of this process, and of the processes that it started, once they have ended."""
    return time.process_time() + sum(os.times()[2:4])


def _busy_s() -> float | None:
    """Busy seconds of all cores since the system started."""
    try:
        user, nice, system, _, _, irq, soft, steal, *_ = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    except OSError:
        return None
    return sum(map(int, (user, nice, system, irq, soft, steal))) / os.sysconf("SC_CLK_TCK")
