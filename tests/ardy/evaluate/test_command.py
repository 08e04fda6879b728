"""The command line of the evaluation: exit code 2 for what cannot be judged, 1 for a missed bound."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint import model_card
from motiongen_ardy.checkpoint.hub import HubError
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.data.dataset import MotionDataset, Segment
from motiongen_ardy.evaluate import __main__ as command
from motiongen_ardy.evaluate import judge_training, sampler
from motiongen_ardy.evaluate.__main__ import main
from motiongen_ardy.evaluate.figure import Sample, summarize
from motiongen_ardy.evaluate.report import Report, read_report, side_by_side
from motiongen_ardy.evaluate.rows.table import FAMILIES
from tests.ardy.conftest import GOLDEN
from tests.ardy.evaluate.held_out import FEW, held_out
from tests.ardy.train.clips import swinging_clip, swinging_dataset

TINY = str(GOLDEN / "tiny-core27" / "checkpoint")


def no_hub(repository: str, revision: str | None = None) -> Path:
    raise HubError(f"{repository} is gated")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["no-such-model"], "no model 'no-such-model'"),
        (["core"], "nvidia/ARDY-Core-RP-20FPS-Horizon40 is gated"),
        ([TINY, "--split", "validation"], "no split 'validation'"),
        ([TINY], "gives vectors of 256 numbers, but the model takes 32"),
        ([TINY, "--text-encoder", "nobody"], "no text encoder 'nobody'"),
        ([TINY, "--steps", "4,11"], "--steps has 11; this model takes 1 to 10"),
        ([str(GOLDEN / "tiny-g134" / "checkpoint")], "the model of g134 at 25"),
        ([TINY, "--text-encoder", "hashed", "--rows", "feet,matching"], "is no judge for core27 at 20 frames a second"),
    ],
)
def test_input_that_cannot_be_judged_exits_with_2_and_one_line(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    dataset = swinging_dataset()
    replace(dataset, clips=tuple(replace(clip, split="test") for clip in dataset.clips)).save(tmp_path)
    monkeypatch.setattr(model_card, "fetch_checkpoint", no_hub)
    monkeypatch.delenv("CHECKPOINTS_DIR", raising=False)
    monkeypatch.setattr(sys, "argv", ["evaluate", arguments[0], str(tmp_path), *arguments[1:]])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


@pytest.mark.parametrize("option", ["--text-guidance", "--constraint-guidance"])
def test_a_guidance_weight_that_is_not_finite_is_refused(
    option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["evaluate", TINY, "data", option, "nan"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert f"argument {option}: 'nan' is no weight; give a finite number" in capsys.readouterr().err


def test_figures_that_cannot_be_written_are_refused_before_judging(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = swinging_dataset()
    replace(dataset, clips=tuple(replace(clip, split="test") for clip in dataset.clips)).save(tmp_path)
    judged: list[Path] = []

    def judge(*_: object) -> None:
        judged.append(tmp_path)
        raise KeyboardInterrupt

    monkeypatch.setattr("motiongen_ardy.evaluate.__main__._judge", judge)
    line = ["evaluate", TINY, str(tmp_path), "--text-encoder", "hashed", "--json"]
    monkeypatch.setattr(sys, "argv", [*line, str(tmp_path / "clips.json" / "figures.json")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert not judged
    assert "clips.json" in capsys.readouterr().err
    monkeypatch.setattr(sys, "argv", [*line, str(tmp_path / "new" / "folder" / "figures.json")])
    with pytest.raises(KeyboardInterrupt):
        main()
    assert (tmp_path / "new" / "folder").is_dir()


def run_evaluation(
    data: Path, monkeypatch: pytest.MonkeyPatch, *options: str, model: str = TINY, rows: str = "seam"
) -> object:
    """The exit code of the command for some rows, with one denoising step and few takes."""
    monkeypatch.setattr(command, "QUICK", FEW)
    line = ["evaluate", model, str(data), "--text-encoder", "hashed", "--quick", "--steps", "1", "--rows", rows]
    monkeypatch.setattr(sys, "argv", [*line, *options])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code


@pytest.mark.parametrize(("option", "place"), [("--png", "file"), ("--takes", "file"), ("--json", "folder")])
def test_sheets_and_takes_that_cannot_be_written_are_refused_before_judging(
    option: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    held_out().save(tmp_path / "data")
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr(command, "_judge", lambda *_: pytest.fail("judged, although nothing can be written"))
    assert run_evaluation(tmp_path / "data", monkeypatch, option, str(tmp_path / place)) == 2
    assert place in capsys.readouterr().err


def test_a_split_of_too_short_clips_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    short = tuple(replace(swinging_clip(number, 19), split="test") for number in range(3))
    replace(swinging_dataset(), clips=short).save(tmp_path)
    assert run_evaluation(tmp_path, monkeypatch) == 2
    assert "no clip of this split is longer than 20 frames" in capsys.readouterr().err


def test_rows_without_any_suitable_clip_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two clips of standing give nothing to judge walking by."""
    still = held_out()
    replace(still, clips=(still.clips[0], still.clips[2])).save(tmp_path)
    run_evaluation(tmp_path, monkeypatch, rows="path,pose")
    told = capsys.readouterr().err
    assert "no takes to judge these by: path: clip's own; path: circle" in told
    assert "heading: 0 degrees off the way" in told
    assert run_evaluation(tmp_path, monkeypatch, rows="pose") == 2
    assert "no bound could be judged" in capsys.readouterr().err


def test_motion_that_is_not_finite_exits_with_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    held_out().save(tmp_path)
    made = sampler.commit_window
    monkeypatch.setattr(sampler, "commit_window", lambda *given: made(*given) * torch.nan)
    assert run_evaluation(tmp_path, monkeypatch, rows="feet") == 2
    assert "the model's motion is not finite from frame 0 on" in capsys.readouterr().err


def test_a_judge_of_the_users_own_is_trained_and_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    held_out().save(tmp_path / "data")
    trained = tuple(replace(clip, id=f"{clip.id}-too", split="train") for clip in held_out().clips)
    segments = (Segment(0, 100, "walk", ("a person goes on",)), Segment(100, 100, "stand", ("a person stops",)))
    replace(held_out(), clips=(*trained, replace(trained[0], id="parts", segments=segments))).save(tmp_path / "train")
    judge = ["--steps", "1", "--text-encoder", "hashed", "--text-width", "32"]
    assert judge_training.main([str(tmp_path / "train"), str(tmp_path / "judge"), *judge]) == 0
    options = ("--judge", str(tmp_path / "judge"), "--json", str(tmp_path / "figures.json"))
    assert run_evaluation(tmp_path / "data", monkeypatch, *options, rows="matching") in (0, 1), capsys.readouterr().err
    rows = [figure["row"] for figure in json.loads((tmp_path / "figures.json").read_text())["figures"]]
    assert "R-precision top-3 of 32" in rows
    assert judge_training.main([str(tmp_path / "gone"), str(tmp_path / "judge")]) == 2
    assert "no clips.json" in capsys.readouterr().err


def test_without_a_judge_only_the_matching_rows_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    held_out().save(tmp_path)
    judged: list[str] = []
    monkeypatch.setattr(command, "FAMILIES", {name: lambda _, name=name: judged.append(name) for name in FAMILIES})
    monkeypatch.setattr(sys, "argv", ["evaluate", TINY, str(tmp_path), "--text-encoder", "hashed"])
    with pytest.raises(SystemExit):
        main()
    assert judged == [name for name in FAMILIES if name != "matching"]
    assert "without the rows of matching: " in capsys.readouterr().err


@pytest.mark.parametrize("rows", ["pose", "text", "session"])
def test_a_robot_model_at_another_frame_rate_is_judged_too(
    rows: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """G1 at 25 frames a second, without head and neck; 6 s are not a whole number of its tokens."""
    skeleton = load_skeleton("g134")
    still = torch.zeros(200, skeleton.num_joints, 4)
    still[..., 0] = 1
    clips = tuple(replace(clip, local_rotations=still) for clip in held_out().clips)
    MotionDataset(skeleton, 25.0, clips).save(tmp_path)
    takes = ("--takes", str(tmp_path / "takes"))
    code = run_evaluation(tmp_path, monkeypatch, *takes, model=str(GOLDEN / "tiny-g134" / "checkpoint"), rows=rows)
    assert code in (0, 1), capsys.readouterr().err
    titles = {str(np.load(take)["title"]) for take in (tmp_path / "takes").iterdir()}
    assert rows != "pose" or all(title.endswith("at frame 53") for title in titles), "1.5 s after the history"


@pytest.mark.parametrize("option", ["--seeds", "--threads"])
def test_zero_seeds_or_threads_are_refused(
    option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["evaluate", TINY, "data", option, "0"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert f"argument {option}: '0' is not a whole number of 1 or more" in capsys.readouterr().err


def test_figures_that_are_not_finite_are_written_as_valid_json(tmp_path: Path) -> None:
    figure = summarize(("feet", "a row", "moving"), "m", [Sample("one", 0.5)], data=math.nan)
    assert figure is not None
    Report({"steps": 4}, [figure]).write(tmp_path / "figures.json")

    def no_json(word: str) -> None:
        pytest.fail(f"{word} is no JSON")

    (row,) = json.loads((tmp_path / "figures.json").read_text(), parse_constant=no_json)["figures"]
    assert row["data"] is None
    assert "a row" in side_by_side({"one": read_report(tmp_path / "figures.json")})
