"""Commands whose standard output cannot be written to: its reader has left, its disk is full, or it was closed."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

PARTS = ("ardy", "client/tools", "compliance")
OUTPUT = [Path(f"{part}/{name}/output.py") for part, name in zip(PARTS, (
    "motiongen_ardy/core", "motiongen_tools", "motiongen_compliance",
), strict=True)]  # fmt: skip
PRINTS_THEN_WRITES = """
import pathlib, sys
from motiongen_tools.output import command

def main():
    for line in range(20_000):
        print(f"line {line} of many", flush=not line)
    pathlib.Path(sys.argv[1]).write_text("written")
    return 4

sys.exit(command(main))
"""
INTERRUPTED = """
import signal, sys
from motiongen_tools.output import command

def main():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
    print("begun")
    signal.raise_signal(signal.SIGINT)

sys.exit(command(main))
"""


@pytest.fixture
def lost() -> Iterator[int]:
    """A pipe that nobody reads."""
    read, write = os.pipe()
    os.close(read)
    yield write
    os.close(write)


@pytest.fixture
def full() -> Iterator[int]:
    with open("/dev/full", "wb") as device:
        yield device.fileno()


def run(stdout: int, *arguments: str) -> tuple[int, str]:
    """The exit code, and what was printed on standard error."""
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(
        [sys.executable, *arguments], stdout=stdout, stderr=subprocess.PIPE, env=usual, text=True, check=False
    )
    return done.returncode, done.stderr


def run_closed(*arguments: str) -> tuple[int, str]:
    """As run, without any standard output."""
    shell = ["sh", "-c", 'exec "$@" >&-', "sh", sys.executable, *arguments]
    done = subprocess.run(shell, stderr=subprocess.PIPE, text=True, check=False)
    return done.returncode, done.stderr


def test_a_command_goes_on_when_the_reader_of_its_output_leaves(lost: int, tmp_path: Path) -> None:
    assert run(lost, "-c", PRINTS_THEN_WRITES, str(tmp_path / "kept")) == (4, "")
    assert (tmp_path / "kept").read_text() == "written"


def test_a_command_says_that_its_output_cannot_be_written(full: int, tmp_path: Path) -> None:
    said = "error: [Errno 28] No space left on device: 'standard output'\n"
    assert run(full, "-c", PRINTS_THEN_WRITES, str(tmp_path / "kept")) == (1, said)


def test_a_command_without_an_output_goes_on(tmp_path: Path) -> None:
    assert run_closed("-c", PRINTS_THEN_WRITES, str(tmp_path / "kept")) == (4, "")
    assert (tmp_path / "kept").exists()


def test_output_is_what_was_printed(tmp_path: Path) -> None:
    with (tmp_path / "shown").open("wb") as file:
        assert run(file.fileno(), "-c", PRINTS_THEN_WRITES, str(tmp_path / "kept")) == (4, "")
    lines = (tmp_path / "shown").read_text().splitlines()
    assert lines == [f"line {line} of many" for line in range(20_000)]


def test_a_command_that_is_interrupted_says_so(tmp_path: Path) -> None:
    with (tmp_path / "shown").open("wb") as file:
        assert run(file.fileno(), "-c", INTERRUPTED) == (130, "interrupted\n")
    assert (tmp_path / "shown").read_text() == "begun\n"


@pytest.mark.parametrize("module", ["motiongen_ardy.robot", "motiongen_tools --help", "motiongen_compliance --help"])
def test_every_command_can_lose_its_reader(module: str, lost: int) -> None:
    assert run(lost, "-m", *module.split()) == (0, "")


def test_a_token_that_nobody_can_see_is_not_announced(lost: int, full: int) -> None:
    for stdout, reason in ((lost, "Broken pipe"), (full, "No space left on device")):
        said = f"error: the token could not be printed: {reason}\n"
        assert run(stdout, "-m", "motiongen_server.identity", "studio") == (1, said)


def test_every_command_runs_its_main_in_this_way(repository: Any) -> None:
    files = [path for path in repository.files if path.suffix == ".py" and str(path).startswith(PARTS)]
    sources = {path: (repository.root / path).read_text(encoding="utf-8") for path in files}
    commands = {path: source for path, source in sources.items() if '__name__ == "__main__"' in source}
    assert len(commands) > 10
    without = [str(path) for path, source in commands.items() if "command" not in called(source)]
    assert without == [], "call output.command(main), so that a reader that leaves does not end the work"


def called(source: str) -> set[str]:
    """The names of the functions that a source calls by their plain names."""
    calls = [node.func for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    return {function.id for function in calls if isinstance(function, ast.Name)}


def test_the_parts_have_equal_copies(repository: Any) -> None:
    """They are distributions that cannot import each other."""
    first, *others = [(repository.root / path).read_text(encoding="utf-8") for path in OUTPUT]
    assert others == [first, first]
