"""The commands of `make train-mini`, one after another: they give a checkpoint folder that can be loaded."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from motiongen_ardy.capabilities import read_capabilities
from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.train import denoiser, prompt_domain, prompt_paces, tokenizer
from motiongen_ardy.train.loop import UNFINISHED
from tests.ardy.train.clips import swinging_clip
from tests.conftest import ROOT

SMALL = "transformer: {width: 16, feed_forward: 32, num_layers: 1, num_heads: 2}"
RECIPE = f"tokenizer: {{latent_dim: 8, levels: 16, {SMALL}}}\ndenoiser: {{{SMALL}}}\nmodel: {{horizon: 16}}\n"
FILES = "files: {sampling.yaml: mini-sampling.yaml, capabilities.yaml: mini-capabilities.yaml}\n"
LAST_TWO = ["prompt_paces", "prompt_domain"]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training set of two contents with eight clips each, neither of them a bow."""
    folder = tmp_path_factory.mktemp("data")
    texts = ("a person stands still", "a person walks forward")
    clips = [replace(swinging_clip(number, 60), captions=(texts[number % 2],)) for number in range(16)]
    MotionDataset(load_skeleton("core27"), 20.0, tuple(clips)).save(folder)
    return folder


def train_small(data: Path, folder: Path, recipe: str) -> Path:
    """A checkpoint folder after two steps of training for each part; each stops early first, and is resumed."""
    for file in prompt_domain.CONFIGS.glob("mini-*.yaml"):
        shutil.copy(file, folder)
    (folder / "recipe.yaml").write_text(recipe)
    options = ["--config", str(folder / "recipe.yaml"), "--steps", "2", "--batch", "2", "--float32", "--device", "cpu"]
    first, second = str(folder / "tokenizer"), str(folder / "denoiser")
    assert tokenizer.main([str(data), first, *options, "--minutes", "1e-9"]) == UNFINISHED
    assert tokenizer.main([str(data), first, *options]) == 0
    assert denoiser.main([str(data), second, "--tokenizer", first, *options, "--minutes", "1e-9"]) == UNFINISHED
    assert denoiser.main([str(data), second, "--tokenizer", first, *options]) == 0
    return folder / "denoiser"


def test_a_model_trained_on_own_captures_can_be_loaded(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = train_small(data, tmp_path, RECIPE + FILES)
    assert prompt_paces.main([str(data), str(folder)]) == 0
    assert load_checkpoint(folder).paces is not None
    assert prompt_domain.main([str(data), str(folder), "--without", "bow"]) == 2
    assert "no such label; it has stand, walk" in capsys.readouterr().err
    assert prompt_domain.main([str(data), str(folder)]) == 0
    assert read_capabilities(folder).domain is not None


def test_a_recipe_without_files_gives_a_model_without_capabilities(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = train_small(data, tmp_path, RECIPE)
    assert prompt_domain.main([str(data), str(folder)]) == 2
    assert "says nothing under knows in a capabilities.yaml" in capsys.readouterr().err
    assert prompt_paces.main([str(data), str(folder)]) == 2
    assert load_checkpoint(folder).paces is None
    assert not read_capabilities(folder).forms


def test_a_denoiser_of_another_tokenizer_is_refused_with_a_message(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    train_small(data, tmp_path, RECIPE)
    options = ["--config", str(tmp_path / "recipe.yaml"), "--steps", "2", "--batch", "2", "--float32", "--seed", "1"]
    assert tokenizer.main([str(data), str(tmp_path / "other"), *options]) == 0
    line = [str(data), str(tmp_path / "denoiser"), "--tokenizer", str(tmp_path / "other"), *options]
    assert denoiser.main(line) == 2
    assert "error: " in (said := capsys.readouterr().err)
    assert "began with another tokenizer" in said


def run_make(tmp_path: Path, code: int, *variables: str) -> tuple[list[list[str]], subprocess.CompletedProcess[str]]:
    """The commands that `make train-mini` runs, with a script for Python that ends the tokenizer with `code`."""
    program, log = tmp_path / "python", tmp_path / "log"
    program.write_text(f'#!/bin/sh\necho "$@" >> {log}\ncase "$2" in *.tokenizer) exit {code};; esac\n')
    program.chmod(0o755)
    named = (f"PYTHON={program}", f"RUN={tmp_path / 'run'}", f"READY={program}", *variables)
    command = ["make", "--old-file", str(program), "train-mini", *named]
    plain = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(command, cwd=ROOT, env=plain, capture_output=True, text=True, check=False)
    lines = [shlex.split(line)[1:] for line in log.read_text().splitlines()]
    return [[line[0].rpartition(".")[2], *line[1:]] for line in lines], done


@pytest.fixture
def claims(tmp_path: Path) -> None:
    (tmp_path / "run" / "denoiser").mkdir(parents=True)
    (tmp_path / "run" / "denoiser" / "capabilities.yaml").touch()


@pytest.mark.usefixtures("claims")
def test_make_passes_unlearned_labels_and_the_encoder_only_where_needed(tmp_path: Path) -> None:
    lines, done = run_make(tmp_path, 0, "TEXT_ENCODER=mine", "ARGS=--steps 2")
    assert done.returncode == 0, done.stderr
    assert [line[0] for line in lines] == ["tokenizer", "denoiser", *LAST_TWO]
    assert [("--text-encoder mine" in " ".join(line), "--steps" in line) for line in lines] == [
        (False, True), (True, True), (True, False), (True, False)
    ]  # fmt: skip
    assert not any("--without" in line for line in lines)
    (tmp_path / "log").unlink()
    lines, done = run_make(tmp_path, 0, "UNLEARNED=bow jump")
    assert lines[3][-3:] == ["--without", "bow", "jump"]


def test_make_explains_why_prompt_steps_are_skipped_without_capabilities(tmp_path: Path) -> None:
    lines, done = run_make(tmp_path, 0, "RECIPE=mine.yaml")
    assert done.returncode == 0, done.stderr
    assert [line[0] for line in lines] == ["tokenizer", "denoiser"]
    assert "they need a capabilities.yaml, and mine.yaml lists none under files" in done.stdout


@pytest.mark.usefixtures("claims")
def test_make_stops_after_an_unfinished_training(tmp_path: Path) -> None:
    lines, done = run_make(tmp_path, UNFINISHED)
    assert done.returncode != 0
    assert [line[0] for line in lines] == ["tokenizer"]


@pytest.mark.parametrize(
    ("recipe", "said"),
    [
        ("model: {horizon: 200}", "model.horizon is 200; a window of training lasts 10 s"),
        ("model: {num_base_steps: 1001}", "num_base_steps is 1001; it must be a whole number from 1 to 1000"),
        ("modle: {}", "unknown keys modle"),
    ],
)
def test_invalid_input_ends_both_trainings_with_2_and_a_message(
    data: Path, tmp_path: Path, recipe: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "recipe.yaml").write_text(RECIPE.replace("model: {horizon: 16}", recipe))
    options = ["--config", str(tmp_path / "recipe.yaml"), "--steps", "1", "--batch", "2", "--float32"]
    options += ["--device", "cpu"]
    run = str(tmp_path / "run")
    if "unknown" in said:
        assert tokenizer.main([str(data), run, *options]) == 2
    else:
        assert tokenizer.main([str(data), run, *options]) == 0
        capsys.readouterr()
        assert denoiser.main([str(data), str(tmp_path / "second"), "--tokenizer", run, *options]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert said in told
    assert tokenizer.main([str(tmp_path / "nothing"), run]) == 2
    assert denoiser.main([str(data), run, "--tokenizer", str(tmp_path / "nothing")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith("error: ") for line in lines if not line.startswith(" "))
    assert "no clips.json; make a set" in lines[0]


def test_a_tokenizer_that_no_checkpoint_can_hold_is_refused_before_training(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Otherwise the first export, hours later, would fail."""
    soma = load_skeleton("soma77")
    still = torch.zeros(60, soma.num_joints, 4)
    still[..., 0] = 1
    clip = replace(swinging_clip(1, 60), local_rotations=still)
    MotionDataset(soma, 20.0, (clip,)).save(tmp_path / "soma")
    run, recipe = tmp_path / "run", tmp_path / "recipe.yaml"
    options = ["--config", str(recipe), "--steps", "1", "--batch", "2", "--device", "cpu"]
    recipe.write_text(RECIPE)
    assert tokenizer.main([str(tmp_path / "soma"), str(run), *options]) == 2
    assert "no checkpoint holds a model of the skeleton soma77; give motion of core27, g134" in capsys.readouterr().err
    recipe.write_text(RECIPE.replace("levels: 16", "levels: 65537"))
    assert tokenizer.main([str(data), str(run), *options]) == 2
    assert "a number of levels from 2 to 65536" in capsys.readouterr().err
    assert not (run / "state.pt").exists()
