"""Weights in bfloat16: which ones are, and how much results change."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, load_tokenizer, save_checkpoint
from motiongen_ardy.model.config import ConfigError
from motiongen_ardy.model.precision import PRECISIONS, InWeightPrecision, matrix_names, set_precision
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from tests.ardy.conftest import GoldenModel

TOLERANCE = 0.05
"""Of a result's spread: bfloat16 keeps 8 bits, so each product is off by up to 2^-9 of itself."""


def test_only_weight_matrices_are_bfloat16(golden: GoldenModel) -> None:
    model = load_checkpoint(golden.folder / "checkpoint", dtype=torch.bfloat16)
    held = {name: part.dtype for name, part in model.named_parameters()}
    matrices = {name for name, part in model.named_parameters() if part.dim() == 2 and "learned_prefix" not in name}
    assert {name for name, dtype in held.items() if dtype == torch.bfloat16} == matrices == matrix_names(model)
    assert {part.dtype for part in model.buffers()} <= {torch.float32, torch.int64, torch.bool}


def test_results_are_float32_and_close_to_the_exact_ones(golden: GoldenModel) -> None:
    vectors = golden.vectors("denoiser_cases")
    window = vectors.window("history.")
    model = load_checkpoint(golden.folder / "checkpoint", dtype=torch.bfloat16)
    with torch.no_grad():
        given = vectors["history.in.x"], vectors["history.in.timesteps"]
        exact, rounded = (one.denoiser(*given, window) for one in (golden.model, model))
    assert rounded.dtype == torch.float32
    assert not torch.equal(rounded, exact)
    assert float((rounded - exact).abs().max()) < TOLERANCE * float(exact.std())


def test_motion_generated_in_bfloat16_is_finite(golden: GoldenModel) -> None:
    model = load_checkpoint(golden.folder / "checkpoint", dtype=torch.bfloat16)
    request = RolloutRequest(60, torch.zeros(model.config.denoiser.text_dim), num_steps=3)
    features = rollout(model, request)
    assert features.dtype == torch.float32
    assert bool(features.isfinite().all())


def test_a_bfloat16_model_is_saved_as_float32(golden: GoldenModel, tmp_path: Path) -> None:
    rounded = load_checkpoint(golden.folder / "checkpoint", dtype=torch.bfloat16)
    save_checkpoint(rounded, tmp_path)
    again = load_checkpoint(tmp_path)
    for (name, before), (_, after) in zip(rounded.state_dict().items(), again.state_dict().items(), strict=True):
        assert after.dtype == torch.float32
        assert torch.equal(before.float(), after), name


def test_a_model_set_back_to_float32_has_the_values_that_bfloat16_kept(golden: GoldenModel) -> None:
    model = load_checkpoint(golden.folder / "checkpoint", dtype=torch.bfloat16)
    kept = {name: part.to(torch.float32, copy=True) for name, part in model.state_dict().items()}
    assert any(not torch.equal(part, kept[name]) for name, part in golden.model.state_dict().items())
    set_precision(model, torch.float32)
    assert {part.dtype for part in model.parameters()} == {torch.float32}
    assert all(torch.equal(part.float(), kept[name]) for name, part in model.state_dict().items())
    networks = [part for part in model.modules() if isinstance(part, InWeightPrecision)]
    assert {network.precision for network in networks} == {torch.float32}


@pytest.mark.parametrize("dtype", [torch.float16, torch.float64, torch.int8])
def test_other_types_are_refused(golden: GoldenModel, dtype: torch.dtype) -> None:
    for load in (load_checkpoint, load_tokenizer):
        with pytest.raises(ConfigError, match=f"{dtype}; weights are held as {' or '.join(PRECISIONS)}"):
            load(golden.folder / "checkpoint", dtype=dtype)
