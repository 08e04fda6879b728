"""The released models' configurations: parameter counts, layout of the folder, windows and nicknames."""

from __future__ import annotations

import pytest
import torch

from motiongen_ardy.checkpoint.config import FolderLayout, read_model_config
from motiongen_ardy.checkpoint.config_writer import write_model_config
from motiongen_ardy.checkpoint.released import NICKNAMES, RELEASED
from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.model import build_model

# Parameters of denoiser and tokenizer: others counted those of the released Core-Horizon40 files; those of the robot
# were counted by building the public modules.
COUNTS = {"core27": (155_823_252, 35_430_052), "g134": (157_887_636, 35_785_204)}


@pytest.mark.parametrize("name", RELEASED)
def test_parameter_counts_are_those_of_the_released_files(name: str) -> None:
    config = RELEASED[name]
    width = load_skeleton(config.skeleton).feature_dim + LOCAL_ROOT_WIDTH
    stats = Stats(torch.zeros(width), torch.ones(width))
    with torch.device("meta"):
        model = build_model(config, stats)
    assert model.tokenizer is not None
    counts = tuple(sum(part.numel() for part in module.parameters()) for module in (model.denoiser, model.tokenizer))
    assert counts == COUNTS[config.skeleton]
    assert model.num_parameters == sum(counts)


@pytest.mark.parametrize("name", RELEASED)
def test_configurations_round_trip_through_the_released_layout(name: str) -> None:
    assert read_model_config(write_model_config(RELEASED[name])) == (RELEASED[name], FolderLayout())


def test_maximum_windows_are_about_ten_seconds() -> None:
    assert [config.max_window_frames for config in RELEASED.values()] == [200, 200, 248, 248]


def test_every_released_model_has_a_nickname_and_no_other_has() -> None:
    assert set(NICKNAMES.values()) == set(RELEASED)
