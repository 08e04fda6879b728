"""Every bench says how it is called and what it measures, before it measures anything."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

STARTED_BY_OTHERS = {"fuzz_targets", "null_engine", "stand_ins"}
"""Programs that benches start in a process of their own: their arguments are not for people."""
WITH_THE_OPTIONS_OF = {"null_server": "motiongen_server", "__main__": "tests.bench"}
"""The command that the help names where it is not the bench's own module."""
BENCHES = sorted(
    path.stem
    for path in Path(__file__).parent.glob("*.py")
    if path.stem not in STARTED_BY_OTHERS and '\nif __name__ == "__main__":' in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", BENCHES)
def test_bench_asked_for_help_says_how_it_is_called_and_ends(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("motiongen_server.ops.memory.keep_freed_memory", lambda: True)  # of this process
    monkeypatch.setattr("sys.argv", [f"{name}.py", "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(Path(__file__).with_name(f"{name}.py")), run_name="__main__")
    assert ended.value.code == 0
    usage, _, rest = capsys.readouterr().out.partition("\n\n")
    command = WITH_THE_OPTIONS_OF.get(name, f"tests.bench.{name}")
    assert re.match(rf"usage: python -m {re.escape(command)} ", usage)
    assert rest.strip(), "what it measures, and its options"


def test_known_benches_are_listed() -> None:
    assert {"__main__", "engine", "scenario_table", "service_cost", "throttled"} <= set(BENCHES)
