"""`make setup` with an existing folder: it removes nothing that it has not created."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT

PYTHON = """#!/bin/sh
if [ "$1 $2 $3" = "-m venv --clear" ]; then rm -rf "$4"; mkdir -p "$4/bin"; echo made > "$4/pyvenv.cfg"; fi
exit 0
"""
"""Stands in for a Python that can create environments."""

WITHOUT_PIP = """#!/bin/sh
case "$2" in
pip) exec test -e "$(dirname "$0")/pip" ;;
ensurepip) {ensurepip} ;;
esac
"""
"""Stands in for the Python of an environment without pip that somebody else has created."""


def program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "an environment"


def make(folder: Path) -> subprocess.CompletedProcess[str]:
    programs = folder.parent / "programs"
    program(programs / "python3.12", PYTHON)
    return subprocess.run(
        ["bash", str(ROOT / ".ci" / "make_venv.sh"), str(folder)],
        env={**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("before", [None, "", "pyvenv.cfg", "lib/python3.12/site-packages/pip/__init__.py", ".ready"])
def test_missing_unfinished_and_own_environments_are_created(folder: Path, before: str | None) -> None:
    if before is not None:
        (folder / before).parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(exist_ok=True)
        if before:
            (folder / before).write_text("")
            (folder / "pyvenv.cfg").touch()
    assert make(folder).returncode == 0
    assert (folder / "pyvenv.cfg").read_text() == "made\n"


@pytest.mark.parametrize("theirs", ["thesis.tex", "photographs/one.png"])
def test_folder_with_other_files_is_left_alone(folder: Path, theirs: str) -> None:
    (folder / theirs).parent.mkdir(parents=True)
    (folder / theirs).write_text("the work of years")
    done = make(folder)
    assert done.returncode == 1
    assert theirs in done.stderr
    assert (folder / theirs).read_text() == "the work of years"


def test_environment_without_pip_gets_it_and_keeps_its_packages(folder: Path) -> None:
    program(folder / "bin" / "python", WITHOUT_PIP.format(ensurepip='touch "$(dirname "$0")/pip"'))
    package = folder / "lib/python3.12/site-packages/theirs-1.0.dist-info/METADATA"
    package.parent.mkdir(parents=True)
    package.write_text("Name: theirs")
    assert make(folder).returncode == 0
    assert (folder / "bin" / "pip").exists()
    assert package.exists()


def test_environment_that_cannot_get_pip_is_left_alone(folder: Path) -> None:
    program(folder / "bin" / "python", WITHOUT_PIP.format(ensurepip="exit 1"))
    (folder / "pyvenv.cfg").write_text("theirs")
    package = folder / "lib/python3.12/site-packages/theirs-1.0.dist-info"
    package.mkdir(parents=True)
    done = make(folder)
    assert done.returncode == 1
    assert package.name in done.stderr
    assert (folder / "pyvenv.cfg").read_text() == "theirs"
