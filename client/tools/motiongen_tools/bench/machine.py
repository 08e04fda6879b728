"""Facts about the machine that a figure was measured on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_DISTRIBUTIONS = ("motiongen-client", "grpcio", "protobuf", "numpy")


def machine_facts() -> dict[str, str]:
    """Facts about the generator's machine, which is also the server's if that has a local address."""
    return {
        "processor": processor(),
        "cores": cores(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        **{name: installed(name) for name in _DISTRIBUTIONS},
    }


def cores() -> str:
    """How many cores there are, and how many this process may use, if the system tells."""
    if not hasattr(os, "sched_getaffinity"):  # only Linux has it
        return str(os.cpu_count())
    return f"{len(os.sched_getaffinity(0))} usable of {os.cpu_count()}"


def installed(distribution: str) -> str:
    """The installed version of a distribution."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed"


def processor() -> str:
    """Name of the processor, if the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
