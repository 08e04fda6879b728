"""No test sleeps: it waits for an event, moves a clock, or polls by tests/waiting.py."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

WAITING = Path("tests/waiting.py")
SLEEPS = {"time.sleep", "asyncio.sleep", "sleep"}


def naps(source: str) -> list[int]:
    """The lines that sleep, other than for a plain 0, or wait for an event that nothing sets."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    named = [call for call in calls if ast.unparse(call.func) in SLEEPS]
    sleeps = [call for call in named if not (call.args and ast.unparse(call.args[0]) == "0")]
    return [call.lineno for call in sleeps + [c for c in calls if c.args and "Event().wait" in ast.unparse(c.func)]]


def test_no_test_sleeps(repository: Any) -> None:
    files = [path for path in repository.files if path.parts[0] == "tests" and path.suffix == ".py"]
    # the programs in tests/bench, tests/attack and tests/scale measure, and may pace themselves
    programs = ("bench", "attack", "scale")
    tests = [path for path in files if path != WAITING and (path.parts[1] not in programs or "test_" in path.name)]
    found = [f"{path}:{line}" for path in tests for line in naps((repository.root / path).read_text(encoding="utf-8"))]
    assert found == [], "see tests/waiting.py"
    assert len(tests) > 100


@pytest.mark.parametrize(
    ("source", "lines"),
    [
        ("await asyncio.sleep(0)", []),
        ("x = 1\ntime.sleep(0.1)", [2]),
        ("await asyncio.sleep(wait_s)", [1]),
        ("from time import sleep\nsleep(5)", [2]),
        ("threading.Event().wait(0.2)", [1]),
    ],
)
def test_sleeps_are_found(source: str, lines: list[int]) -> None:
    assert naps(source) == lines
