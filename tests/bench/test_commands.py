"""Every bench can be imported and says what it measures."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

STARTED_BY_OTHERS = {"fuzz_targets"}
"""Started by `fuzz_edge`, in a process of its own, with packages that `make fuzz` installs."""
BENCHES = sorted(
    path.stem
    for path in Path(__file__).parent.glob("*.py")
    if not path.stem.startswith(("test_", "__"))
    and path.stem not in STARTED_BY_OTHERS
    and "__main__" in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", BENCHES)
def test_bench_can_be_imported_and_has_a_docstring(name: str) -> None:
    module = importlib.import_module(f"tests.bench.{name}")
    assert module.__doc__, "the first line says what it measures, and by which command"


def test_known_benches_are_listed() -> None:
    assert {"engine", "scenario_table", "service_cost", "throttled"} <= set(BENCHES)
