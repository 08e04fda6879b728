"""The paces of prompts: from captures to the file, and the file of the built-in model."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import model_folder
from motiongen_ardy.checkpoint.paces_file import PACES_FILE, read_paces
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.data.dataset import Clip, MotionDataset, Segment
from motiongen_ardy.text import load_text_encoder
from motiongen_ardy.train import prompt_domain
from motiongen_ardy.train.prompt_paces import caption_speeds, main
from tests.ardy.conftest import GOLDEN
from tests.ardy.train.clips import swinging_clip

CONFIGS = Path(__file__).parents[3] / "ardy" / "motiongen_ardy" / "train" / "configs"


def clip(number: int, speed: float, captions: tuple[str, ...], **changes: object) -> Clip:
    """Six seconds at a speed in m/s."""
    made = swinging_clip(number, 120)
    root = made.root_positions.clone()
    root[:, 2] = torch.arange(120) / 20 * speed
    return replace(made, root_positions=root, captions=captions, content=captions[0], **changes)  # type: ignore[arg-type]


def test_speeds_of_a_caption_are_those_of_its_captures() -> None:
    standing = replace(clip(3, 1.0, ("walks and stops",)), segments=(Segment(60, 60, "stop", ("stops",)),))
    standing.root_positions[60:, 2] = standing.root_positions[60, 2]
    made = clip(4, 9.0, ("walks",), derived_from="clip")
    speeds = caption_speeds([clip(1, 1.0, ("walks", "goes")), clip(2, 1.4, ("walks",)), standing, made], 20.0)
    assert speeds["goes"] == pytest.approx((1.0, 1.0), abs=1e-3)
    assert speeds["walks"] == pytest.approx((1.0, 1.4), abs=1e-3)
    assert speeds["walks and stops"] == pytest.approx((1.0, 1.0), abs=1e-3)
    assert speeds["stops"] == pytest.approx((0.0, 0.0), abs=1e-3)
    assert caption_speeds([replace(clip(1, 1.0, ("walks",)), root_positions=torch.zeros(25, 3))], 20.0) == {}


def test_the_command_writes_a_file_that_a_checkpoint_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    captions = {"a person stands still": 0.0, "a person walks forward": 1.2, "a person runs": 3.0}
    clips = [
        replace(clip(number, speed, (text,)), id=f"{number}-{text}")
        for text, speed in captions.items()
        for number in range(12)
    ]
    MotionDataset(load_skeleton("core27"), 20.0, tuple(clips)).save(tmp_path / "data")
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    assert main([str(tmp_path / "data"), str(folder)]) == 2
    assert "names no gaits" in capsys.readouterr().err
    shutil.copy(CONFIGS / "mini-capabilities.yaml", folder / "capabilities.yaml")
    assert main([str(tmp_path / "data"), str(folder)]) == 0
    assert "3 of 3 captions kept" in capsys.readouterr().out
    paces = read_paces(folder / PACES_FILE, 256)
    found = paces.of(torch.from_numpy(load_text_encoder("static").encode(["a person walks forward"]))[0])
    assert found == pytest.approx((1.2, 1.2), abs=0.01)
    assert main([str(tmp_path / "none"), str(folder)]) == 2
    MotionDataset(load_skeleton("core27"), 20.0, tuple(clips[9:15])).save(tmp_path / "few")
    capsys.readouterr()
    assert main([str(tmp_path / "few"), str(folder)]) == 2
    assert "set fit_prompts to false" in capsys.readouterr().err


def test_vectors_of_another_width_than_that_of_the_model_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With them, the checkpoint folder could not be loaded."""
    clips = [replace(clip(number, 1.0, ("a person walks", "someone goes")), id=f"{number}") for number in range(9)]
    MotionDataset(load_skeleton("core27"), 20.0, tuple(clips)).save(tmp_path / "data")
    folder = tmp_path / "checkpoint"
    shutil.copytree(GOLDEN / "tiny-core27" / "checkpoint", folder)
    shutil.copy(CONFIGS / "mini-capabilities.yaml", folder / "capabilities.yaml")
    for command in (main, prompt_domain.main):
        assert command([str(tmp_path / "data"), str(folder)]) == 2
        assert "gives vectors of 256 numbers, but the model takes 32" in capsys.readouterr().err
        assert command([str(tmp_path / "data"), str(folder), "--text-encoder", "hashed"]) == 0
    paces = load_checkpoint(folder).paces
    assert paces is not None
    assert paces.mean.shape == (32,)


@pytest.mark.parametrize("command", [main, prompt_domain.main])
def test_captions_that_do_not_differ_are_refused(
    command: Callable[[list[str]], int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clips = [replace(clip(number, 1.0, ("a person walks",)), id=f"{number}") for number in range(9)]
    MotionDataset(load_skeleton("core27"), 20.0, tuple(clips)).save(tmp_path / "data")
    shutil.copy(CONFIGS / "mini-capabilities.yaml", tmp_path / "capabilities.yaml")
    assert command([str(tmp_path / "data"), str(tmp_path)]) == 2
    assert "error: no two captions differ, of 1" in capsys.readouterr().err


def test_the_built_in_model_knows_the_paces_of_its_prompts() -> None:
    model = load_checkpoint(model_folder("motiongen-mini"))
    encoder = load_text_encoder("static")
    assert model.sampling.fit_prompts
    assert model.paces is not None

    def usual(prompt: str) -> tuple[float, float] | None:
        assert model.paces is not None
        return model.paces.of(torch.from_numpy(encoder.encode([prompt]))[0])

    for prompt in (
        "a person stands still",
        "someone waves with the left hand",
        "the man takes a bow",
        "raise both arms",
    ):
        found = usual(prompt)
        assert found is not None
        assert found[1] < 0.4
    for prompt, speed in (("a person walks forward", 1.2), ("she jogs", 3.0), ("an old man walks along", 0.8)):
        found = usual(prompt)
        assert found is not None
        assert found[0] < speed < found[1], prompt
    assert usual("a person swims") is None
    walk = torch.from_numpy(encoder.encode(["a person walks forward", "a person walks backward"]))
    torch.testing.assert_close(model.paces.gait(1.2, 0.0), walk[0])
    torch.testing.assert_close(model.paces.gait(1.0, math.pi), walk[1])
