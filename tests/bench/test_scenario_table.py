"""The table of scenarios: its cases, its lines, and revisions beside each other."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.bench.machine import ROOT
from tests.bench.revision import Revision, commit_tree
from tests.bench.scenario_rows import HEADER, found_row, rows_of
from tests.bench.scenario_table import cases, parse

NOW = Revision("now", ROOT)


def _report(missed: int, p99: float, **more: object) -> dict[str, object]:
    figures = {name: {"due": 1000, "missed": missed, "refused": 2} for name in ("all", "hero", "near")}
    latency = {"count": 9, "p50": 100.0, "p99": p99}
    names = ("event_to_first_frame", "open_to_first_frame")
    return {
        "figures": figures,
        "latencies_ms": {what: dict.fromkeys(figures, latency) for what in names},
        "counts": {"service level: FEWER_STEPS, 3 steps": 4, "service level: FULL, 4 steps": 4, "edits": 7},
        "server_use": {"cores": 1.5},
        "void": [],
        "others": 0.25,
        **more,
    }


def test_seeds_are_one_line_with_the_worst_tail_and_all_that_was_missed() -> None:
    lines = rows_of("mixed", 80, "float32", [_report(0, 200.0), _report(5, 300.0, void=["late"])])
    assert lines[0] == ("| mixed | 80 | float32 | 0.25% | 8 | 4 | 100 / 300 | 100 / 300 | 1.50 | 25% | 1 of 2 |")
    assert [line.split("|")[1].strip() for line in lines] == ["mixed", "- hero", "- near"]
    assert {line.count("|") for line in (*HEADER, *lines)} == {12}


def test_a_search_says_where_the_load_was_its_limit() -> None:
    search = {"characters": 150, "limited_by_generator": True}
    assert found_row("crowd", "float32", {"search": search}) == "| crowd | float32 | at least 150 | yes |"


def test_every_scenario_is_measured_in_both_precisions_at_its_own_size() -> None:
    found = {(case.scenario, case.precision): case.characters for case in cases(parse([]), [NOW])}
    assert len(found) == 12
    assert (found["crowd", "float32"], found["crowd", "bfloat16"], found["mixed", "float32"]) == (100, 200, 80)


def test_a_number_for_each_scenario_or_none(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse(["--scenario", "hero", "mixed", "--characters", "12"])
    assert "--characters has 1 numbers" in capsys.readouterr().err


def test_a_revision_runs_its_own_code() -> None:
    command = [*NOW.motiongen[:1], "-c", "import motiongen_server, motiongen_tools; print(motiongen_server.__file__)"]
    done = subprocess.run(command, env=NOW.environment, cwd=os.sep, stdout=subprocess.PIPE, text=True, check=True)
    assert Path(done.stdout.strip()).is_relative_to(ROOT)
    assert NOW.motiongen[1:] == ["-m", "motiongen_tools"]


def test_a_commit_is_checked_out_beside_and_removed() -> None:
    with commit_tree("HEAD") as revision:
        assert (revision.tree / "server/motiongen_server/app.py").exists()
    assert not revision.tree.exists()
