"""A model's sampling options: what their file may contain, and the defaults without one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import yaml

from motiongen_ardy.checkpoint.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from motiongen_ardy.checkpoint.sampling_file import read_options, write_options
from motiongen_ardy.model.config import ConfigError
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights, Pass, needed_passes
from motiongen_ardy.model.sampling.options import (
    GuidanceOptions,
    PlanOptions,
    ProjectionOptions,
    SamplingOptions,
    released_options,
)

ROOT = Path(__file__).parents[4]
TINY = ROOT / "tests" / "data" / "golden" / "tiny-core27" / "checkpoint"


def test_a_model_without_a_sampling_file_uses_the_released_options() -> None:
    model = load_checkpoint(TINY)
    assert model.sampling == released_options(model.config.guidance)
    assert model.sampling.guidance == GuidanceOptions("separated", 2.0, 2.0)
    assert model.sampling == SamplingOptions()


def test_saved_sampling_options_are_loaded_again(tmp_path: Path) -> None:
    model = load_checkpoint(TINY)
    save_checkpoint(model, tmp_path)
    assert not (tmp_path / "sampling.yaml").exists()
    model.sampling = SamplingOptions(GuidanceOptions("joint", 1.0, 1.5), plan_root=True, plan=PlanOptions(4))
    save_checkpoint(model, tmp_path)
    assert load_checkpoint(tmp_path).sampling == model.sampling
    model.sampling = released_options(model.config.guidance)
    save_checkpoint(model, tmp_path)
    assert load_checkpoint(tmp_path).sampling == model.sampling


def test_options_round_trip_through_yaml() -> None:
    options = SamplingOptions(project_root=True, projection=ProjectionOptions(slack_m=0.07))
    assert read_options(yaml.safe_load(yaml.safe_dump(write_options(options))), "separated") == options


def test_options_missing_from_the_file_are_as_released() -> None:
    assert read_options({"plan_root": True}, "regular") == replace(released_options("regular"), plan_root=True)


def test_the_built_in_models_file_can_be_read() -> None:
    content = yaml.safe_load(
        (ROOT / "ardy" / "motiongen_ardy" / "train" / "configs" / "mini-sampling.yaml").read_text()
    )
    options = read_options(content, "separated")
    assert (options.guidance.mode, options.guidance.text, options.guidance.constraint) == ("joint", 1.0, 1.0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"plan_rot": True}, "unknown keys plan_rot; known keys are approach_frames, clean_feet"),
        ({"plan": {"stride": 2}}, "sampling.yaml.plan has unknown keys stride; known keys are acceleration"),
        ({"plan": {"stride_frames": 2.5}}, "sampling.yaml.plan.stride_frames is 2.5; it must be a whole number from 1"),
        ({"plan": {"speed_m_s": float("nan")}}, "speed_m_s is nan"),
        ({"guidance": {"mode": "both"}}, "mode is 'both'; it must be one of joint, separated"),
        ({"guidance": {"text": True}}, "text is True; it must be a number from 0 to 10"),
        ({"clean_feet": 1}, "clean_feet is 1; it must be true or false"),
        ({"guidance": 3}, "sampling.yaml.guidance is 3; it must be a mapping"),
        ([], "sampling.yaml is []; it must be a mapping"),
    ],
)
def test_invalid_options_are_refused_by_name(content: object, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_options(content, "separated")
    assert words in str(caught.value)


def test_a_checkpoint_with_an_invalid_sampling_file_is_refused(tmp_path: Path) -> None:
    save_checkpoint(load_checkpoint(TINY), tmp_path)
    (tmp_path / "sampling.yaml").write_text("plan_roots: true\n")
    with pytest.raises(CheckpointError, match="plan_roots"):
        load_checkpoint(tmp_path)


def test_clean_feet_is_refused_for_a_robot_without_two_bone_legs(tmp_path: Path) -> None:
    save_checkpoint(load_checkpoint(TINY.parents[1] / "tiny-g134" / "checkpoint"), tmp_path)
    (tmp_path / "sampling.yaml").write_text("clean_feet: true\n")
    with pytest.raises(CheckpointError, match=r"g134 has no legs of two bones"):
        load_checkpoint(tmp_path)


def test_joint_guidance_with_both_weights_1_takes_one_pass() -> None:
    assert needed_passes("joint", GuidanceWeights(1.0, 1.0), True, True) == (Pass(True, True, 1.0),)
    # Without constraints it equals separated guidance: u + 3 (text - u).
    assert needed_passes("joint", GuidanceWeights(3.0, 1.0), True, False) == (
        Pass(True, False, 3.0),
        Pass(False, False, -2.0),
    )


def test_passes_of_joint_guidance_add_up_to_its_formula() -> None:
    both, text, goals, neither = torch.randn(4).unbind()
    values = {(True, True): both, (True, False): text, (False, True): goals, (False, False): neither}
    found = sum(
        one.weight * values[one.with_text, one.with_constraints]
        for one in needed_passes("joint", GuidanceWeights(1.5, 2.5), True, True)
    )
    assert torch.allclose(torch.as_tensor(found), both + 0.5 * (text - neither) + 1.5 * (goals - neither))
