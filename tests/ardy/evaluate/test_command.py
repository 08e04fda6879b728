"""The command line of the evaluation: what cannot be judged is told apart from what has missed a bound."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from motiongen_ardy.checkpoint import model_card
from motiongen_ardy.checkpoint.hub import HubError
from motiongen_ardy.evaluate.__main__ import main
from tests.ardy.conftest import GOLDEN
from tests.ardy.train.clips import swinging_dataset

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
    ],
)
def test_what_cannot_be_judged_ends_with_2_and_one_line(
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
def test_a_weight_that_is_no_number_is_refused(
    option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["evaluate", TINY, "data", option, "nan"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert f"argument {option}: 'nan' is no weight; give a finite number" in capsys.readouterr().err


def test_figures_that_cannot_be_written_are_not_made(
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
