"""Every family of the evaluation that needs no judge runs to its end on an untrained model."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from motiongen_ardy.evaluate import __main__ as command
from motiongen_ardy.evaluate.rows.table import FAMILIES
from tests.ardy.conftest import GOLDEN
from tests.ardy.evaluate.held_out import FEW, held_out


def test_all_rows_that_need_no_judge_yield_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held_out().save(tmp_path / "data")
    monkeypatch.setattr(command, "QUICK", FEW)
    rows = [name for name in FAMILIES if name != "matching"]
    line = ["evaluate", str(GOLDEN / "tiny-core27" / "checkpoint"), str(tmp_path / "data"), "--text-encoder", "hashed"]
    line += ["--quick", "--steps", "1", "--rows", ",".join(rows), "--json", str(tmp_path / "figures.json")]
    monkeypatch.setattr(sys, "argv", line)
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 1, "an untrained model misses its bounds, and the exit code says so"
    figures = json.loads((tmp_path / "figures.json").read_text())["figures"]
    judged = {figure["family"] for figure in figures}
    assert judged == {
        "waypoint",
        "path",
        "heading",
        "pose",
        "velocity",
        "feet",
        "short",
        "seam",
        "text",
        "tokenizer",
        "session",
    }
