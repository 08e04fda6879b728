"""The bench for a GPU, without a GPU: its parts, its goals, and its message if there is none."""

import json
from pathlib import Path

import pytest
import torch

from tests.bench.contest import NAMES
from tests.bench.gpu_engine import PARTS, parse, steered
from tests.bench.gpu_goals import goals, reports_in


def report(folder: Path, part: str, name: str, characters: int, efficiency: float, p99: float | None) -> None:
    standing = {"name": name, "characters": characters, "edit_to_frame_ms": {"p50": 20.0, "p99": p99}}
    ceilings = [{"precision": "bfloat16", "efficiency": efficiency}, {"precision": "float32", "efficiency": 0.9}]
    (folder / part).mkdir()
    (folder / part / "engine.json").write_text(json.dumps({"standings": [standing], "ceilings": ceilings}))


def test_goals_are_compared_with_the_results_of_all_parts(tmp_path: Path) -> None:
    report(tmp_path, "single", "B0", 100, 0.4, None)
    report(tmp_path, "served", "B5", 3100, 0.5, 75.0)
    assert goals(reports_in(tmp_path))[2:] == [
        "| characters against one window at a time | 30.0 times | 31.0 times | yes |",
        "| whole windows against the bfloat16 matrix product | 45% | 50% | yes |",
        "| edit to frame at 70 % load, p99 | 60 ms | 75 ms | no |",
    ]


def test_goal_without_a_measurement_is_not_met(tmp_path: Path) -> None:
    report(tmp_path, "single", "B0", 100, 0.4, None)
    assert [line.rsplit("|", 2)[1].strip() for line in goals(reports_in(tmp_path))[2:]] == ["-", "no", "-"]


def test_parts_contain_the_engines_that_the_goals_need() -> None:
    assert {name for names in PARTS.values() for name in names} <= set(NAMES)
    assert (PARTS["single"], PARTS["served"]) == (("B0",), ("B5",))
    options = parse(["--device", "cpu", "--tiny", "--part", "served"])
    assert (options.part, options.precision, options.rows) == (["served"], "bfloat16", 128)


def test_without_a_gpu_the_error_names_the_options_that_run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(SystemExit):
        parse([])
    assert "--device cpu --tiny" in capsys.readouterr().err


def test_steered_windows_of_the_built_in_model_are_finite() -> None:
    assert steered("cpu") == 12
