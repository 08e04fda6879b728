"""Builds client/cpp with CMake, in folders that later runs reuse."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "client" / "cpp"
OUT = ROOT / "out" / "cpp"


class BuildFailed(Exception):
    """The build failed; the message is the output of CMake or the compiler."""


def build(name: str, *settings: str, targets: tuple[str, ...] = ("all",)) -> Path:
    """Configure and build in out/cpp/NAME. Returns that folder. Raises BuildFailed with the tools' output."""
    if shutil.which("cmake") is None:
        raise BuildFailed(
            "there is no cmake: `make cpp` installs what the C++ client is built with, or says what it is"
        )
    folder = OUT / name
    launcher = ["-DCMAKE_CXX_COMPILER_LAUNCHER=ccache"] if shutil.which("ccache") else []
    flags = ["-DCMAKE_BUILD_TYPE=Debug", "-DCMAKE_CXX_FLAGS_DEBUG=-O1 -g1"]
    run("cmake", "-S", SOURCE, "-B", folder, "-G", "Ninja", *flags, *launcher, *settings)
    run("cmake", "--build", folder, "--parallel", str(len(os.sched_getaffinity(0))), "--target", *targets)
    return folder


def run(*command: str | Path, folder: Path = ROOT, environment: dict[str, str] | None = None) -> str:
    """The output of a command. Raises BuildFailed with it unless the exit code is 0."""
    done = subprocess.run(
        [*map(str, command)], cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if done.returncode:
        raise BuildFailed(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout[-8000:]}")
    return done.stdout
