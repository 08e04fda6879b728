"""The Makefile in a copy of the repository without git, and what `make clean` removes."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT

PARTS = ("proto", "ardy", "server", "client/python", "client/tools", "compliance")
PAGE = "client/tools/motiongen_tools/view/page"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A folder with a blank in its name, the Makefile, and sources of the C++ client and a part."""
    folder = tmp_path / "a copy"
    for file in (
        "client/cpp/src/one.cpp",
        "client/cpp/include/one.hpp",
        "client/cpp/include/one.h",
        "ardy/pyproject.toml",
    ):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text("")
    shutil.copy(ROOT / "Makefile", folder)
    return folder


def make(folder: Path, *arguments: str) -> str:
    environment = {**os.environ, "GIT_CEILING_DIRECTORIES": str(folder.parent)}
    done = subprocess.run(
        ["make", "--no-print-directory", *arguments], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def test_without_git_lint_finds_the_cpp_files(copy: Path) -> None:
    """Without a file, clang-format would wait for standard input."""
    (copy / ".venv").mkdir()
    for name in ("constraints.txt", "requirements-dev.txt", *(f"{part}/pyproject.toml" for part in PARTS)):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_text("")
    (copy / ".venv" / ".ready").write_text("")
    (line,) = (line for line in make(copy, "-n", "lint").splitlines() if "clang-format" in line)
    files = set(line.split()) & {"client/cpp/src/one.cpp", "client/cpp/include/one.hpp", "client/cpp/include/one.h"}
    assert len(files) == 3


def test_clean_removes_only_what_was_built(copy: Path) -> None:
    made = [
        ".venv/bin/python", "out/demo/walk.bvh", f"{PAGE}/node_modules/three/LICENSE", "ardy/build/lib/gone.py",
        "client/tools/build/lib/gone.py", "ardy/motiongen_ardy.egg-info/PKG-INFO", "ardy/__pycache__/one.pyc",
    ]  # fmt: skip
    for name in (*made, "ardy/motiongen_ardy/data/build.py"):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_text("")
    make(copy, "clean")
    left = {path.relative_to(copy).as_posix() for path in copy.rglob("*") if path.is_file()}
    assert not left & set(made)
    assert {"Makefile", "ardy/motiongen_ardy/data/build.py", "client/cpp/src/one.cpp"} <= left
