"""The table of scenarios: its cases, its rows, and several revisions."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.bench.machine import ROOT
from tests.bench.revision import Revision, commit_tree
from tests.bench.scenario_rows import HEADER, found_row, rows_of
from tests.bench.scenario_table import cases, kept, parse

NOW = Revision("now", ROOT)


def _report(missed: int, p99: float, **more: object) -> dict[str, object]:
    figures = {name: {"due": 1000, "missed": missed, "refused": 0} for name in ("all", "hero", "near")}
    latency = {"count": 9, "p50": 100.0, "p99": p99}
    names = ("event_to_first_frame", "open_to_first_frame")
    return {
        "figures": figures,
        "latencies_ms": {what: dict.fromkeys(figures, latency) for what in names},
        "counts": {
            "service level: FEWER_STEPS, 3 steps": 4,
            "service level: FULL, 4 steps": 4,
            "edits": 7,
            "refused open: OVERLOADED": 10,
            "refused open: SESSION_LIMIT": 1,
            "refused edit: OVERLOADED": 3,
        },
        "server_use": {"cores": 1.5, "thrown_away": missed / 100},
        "void": [],
        "others": 0.25,
        **more,
    }


def test_seeds_become_one_row_with_the_worst_tail_and_total_misses() -> None:
    lines = rows_of("mixed", 80, "float32", [_report(0, 200.0), _report(5, 300.0, void=["late"])])
    assert lines[0] == (
        "| mixed | 80 | float32 | 0.25% | 8 | 22 | 100 / 300 | 100 / 300 | 5.0% | 1.50 | 25% | 1 of 2 |"
    )
    assert [line.split("|")[1].strip() for line in lines] == ["mixed", "- hero", "- near"]
    assert {line.count("|") for line in (*HEADER, *lines)} == {13}


def test_figure_missing_in_an_earlier_commit_is_left_out() -> None:
    (line, *_) = rows_of("mixed", 80, "float32", [_report(0, 200.0, server_use={"cores": 1.5})])
    assert "| - | 1.50 | 25% | no |" in line


def test_search_limited_by_the_load_is_marked() -> None:
    search = {"characters": 150, "limited_by_generator": True, "trials": [{}] * 4}
    assert found_row("crowd", "float32", {"search": search}) == "| crowd | float32 | at least 150 | yes | no | 4 |"


def test_search_that_ran_out_of_time_is_marked() -> None:
    search = {"characters": 250, "limited_by_generator": False, "out_of_time": True, "trials": [{}] * 7}
    row = found_row("crowd", "bfloat16", {"search": search, "figures": {}})
    assert row == "| crowd | bfloat16 | at least 250 | no | yes | 7 |"


def test_share_of_the_load_is_a_share_of_the_characters() -> None:
    options = parse(["--scenario", "crowd", "--precision", "float32", "--characters", "206", "--load", "0.7"])
    assert [case.characters for case in cases(options, [NOW])] == [144]


def test_only_complete_runs_of_the_same_command_and_commit_are_reused(tmp_path: Path) -> None:
    mark = {"command": ["motiongen", "bench"], "commit": "abc"}
    assert kept(tmp_path, mark) is None
    (tmp_path / "run.json").write_text(json.dumps({**mark, "others": 0.1}))
    assert kept(tmp_path, mark) is None  # a run that was cut short
    (tmp_path / "result.json").write_text(json.dumps({"result": {"void": []}, "search": None}))
    assert kept(tmp_path, mark) == {"void": [], "search": None, "others": 0.1}
    assert kept(tmp_path, {**mark, "commit": "abd"}) is None
    assert kept(tmp_path, {**mark, "command": ["motiongen", "bench", "--find"]}) is None


def test_every_scenario_is_measured_in_both_precisions_at_its_own_size() -> None:
    found = {(case.scenario, case.precision): case.characters for case in cases(parse([]), [NOW])}
    assert len(found) == 12
    assert (found["crowd", "float32"], found["crowd", "bfloat16"], found["mixed", "float32"]) == (100, 200, 80)


def test_wrong_number_of_character_counts_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse(["--scenario", "hero", "mixed", "--characters", "12"])
    assert "--characters has 1 numbers" in capsys.readouterr().err


def test_revision_runs_its_own_code() -> None:
    command = [*NOW.motiongen[:1], "-c", "import motiongen_server, motiongen_tools; print(motiongen_server.__file__)"]
    done = subprocess.run(command, env=NOW.environment, cwd=os.sep, stdout=subprocess.PIPE, text=True, check=True)
    assert Path(done.stdout.strip()).is_relative_to(ROOT)
    assert NOW.motiongen[1:] == ["-m", "motiongen_tools"]


def test_commit_is_checked_out_in_a_worktree_and_removed() -> None:
    with commit_tree("HEAD") as revision:
        assert (revision.tree / "server/motiongen_server/app.py").exists()
    assert not revision.tree.exists()
