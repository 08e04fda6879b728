"""Every part of the evaluation runs to its end on a model that has learned nothing."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.evaluate import __main__ as command
from motiongen_ardy.evaluate.context import Size
from motiongen_ardy.evaluate.rows.table import FAMILIES
from tests.ardy.conftest import GOLDEN
from tests.ardy.train.clips import swinging_clip, swinging_dataset

FEW = Size(seeds=1, moving=1, standing=1, sessions=2, matched=4, long_s=8, long_sessions=1)


def held_out() -> MotionDataset:
    """Two that walk on and two that stay where they are, long enough for every part."""
    clips = [swinging_clip(number, 200) for number in range(4)]
    stays = torch.tensor([0.0, 0.97, 0.0]).expand(200, 3)
    clips[0], clips[2] = (replace(clip, root_positions=stays) for clip in (clips[0], clips[2]))
    return replace(swinging_dataset(), clips=tuple(replace(clip, split="test") for clip in clips))


def test_all_parts_that_need_no_judge_end_with_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held_out().save(tmp_path / "data")
    monkeypatch.setattr(command, "QUICK", FEW)
    rows = [name for name in FAMILIES if name != "matching"]
    line = ["evaluate", str(GOLDEN / "tiny-core27" / "checkpoint"), str(tmp_path / "data"), "--text-encoder", "hashed"]
    line += ["--quick", "--steps", "1", "--rows", ",".join(rows), "--json", str(tmp_path / "figures.json")]
    monkeypatch.setattr(sys, "argv", line)
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 1, "it has learned nothing, so it misses its bounds, and that is told"
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
