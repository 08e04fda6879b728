from __future__ import annotations

from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.model.denoiser.guidance import (
    GuidanceWeights,
    Pass,
    batch_passes,
    full_passes,
    guided_prediction,
    needed_passes,
)

MODES = {"separated": "separated", "regular": "regular", "none": "nocfg"}
WEIGHT = st.sampled_from([0.0, 0.3, 1.0, 1.5, 2.0]) | st.floats(-4, 8)


@pytest.mark.parametrize("needed_only", [False, True])
@pytest.mark.parametrize("constrained", [False, True])
@pytest.mark.parametrize("mode", MODES)
def test_guided_predictions_match_the_golden_vectors(
    golden: Any, mode: Any, constrained: bool, needed_only: bool
) -> None:
    vectors = golden.vectors("guidance")
    window = vectors.window() if constrained else vectors.window().without_constraints()
    weights = GuidanceWeights(vectors["in.weight_text"].item(), vectors["in.weight_constraint"].item())
    passes = needed_passes(mode, weights, True, constrained) if needed_only else full_passes(mode, weights)
    with torch.no_grad():
        guided = guided_prediction(
            golden.model.denoiser, vectors["in.x"], vectors["in.timesteps"], window, batch_passes([passes] * 2)
        )
    vectors.check(f"out.{MODES[mode]}{'' if constrained else '_unconstrained'}", guided)


@pytest.mark.parametrize("mode", ["separated", "regular"])
def test_single_passes_match_the_golden_vectors(golden: Any, mode: Any) -> None:
    vectors = golden.vectors("guidance")
    passes = full_passes(mode, GuidanceWeights())
    predictions = []
    for one in passes:
        batch = batch_passes([(one._replace(weight=1.0),)] * 2)
        with torch.no_grad():
            predictions.append(
                guided_prediction(
                    golden.model.denoiser, vectors["in.x"], vectors["in.timesteps"], vectors.window(), batch
                )
            )
    vectors.check(f"out.{mode}_passes", torch.stack(predictions))


def test_rows_are_guided_by_their_own_weights(golden: Any) -> None:
    vectors, denoiser = golden.vectors("guidance"), golden.model.denoiser
    tokens, step, window = vectors["in.x"], vectors["in.timesteps"], vectors.window()
    unlike = [
        full_passes("separated", GuidanceWeights(2.0, 1.5)),
        needed_passes("none", GuidanceWeights(), True, True),
    ]
    with torch.no_grad():
        mixed = guided_prediction(denoiser, tokens, step, window, batch_passes(unlike))
        for row, passes in enumerate(unlike):
            same = guided_prediction(denoiser, tokens, step, window, batch_passes([passes] * 2))
            torch.testing.assert_close(mixed[row], same[row], atol=1e-5, rtol=0)


@settings(deadline=None)
@given(st.sampled_from(list(MODES)), WEIGHT, WEIGHT, st.booleans(), st.booleans())
def test_needed_passes_have_the_same_sum_as_all_passes(
    mode: Any, text: float, constraint: float, has_text: bool, has_constraints: bool
) -> None:
    """Whatever the four evaluations give, the needed passes weight them as the formula does."""
    weights = GuidanceWeights(text, constraint)
    passes = needed_passes(mode, weights, has_text, has_constraints)
    value = {(False, False): 0.7, (True, False): -1.3, (False, True): 2.9, (True, True): 0.11}
    expected = sum(
        one.weight * value[one.with_text and has_text, one.with_constraints and has_constraints]
        for one in full_passes(mode, weights)
    )
    assert sum(one.weight * value[one.with_text, one.with_constraints] for one in passes) == pytest.approx(
        expected, abs=1e-9
    )
    told = [(one.with_text, one.with_constraints) for one in passes]
    assert len(set(told)) == len(told), "no evaluation is done twice"
    assert all(one.weight for one in passes), "no evaluation has the weight 0"
    assert all(has_text or not one.with_text for one in passes)
    assert all(has_constraints or not one.with_constraints for one in passes)
    assert len(passes) > 1 or passes[0].weight == 1.0


@pytest.mark.parametrize(
    ("has_text", "has_constraints", "weights", "count"),
    [
        (True, True, GuidanceWeights(2, 2), 3),
        (True, False, GuidanceWeights(2, 2), 2),
        (False, True, GuidanceWeights(2, 2), 2),
        (False, False, GuidanceWeights(2, 2), 1),
        (True, False, GuidanceWeights(1, 0), 1),
        (True, True, GuidanceWeights(0, 1), 1),
        (True, True, GuidanceWeights(2, -1), 2),
    ],
)
def test_number_of_passes(has_text: bool, has_constraints: bool, weights: GuidanceWeights, count: int) -> None:
    assert len(needed_passes("separated", weights, has_text, has_constraints)) == count


def test_without_guidance_the_weights_have_no_effect() -> None:
    assert needed_passes("none", GuidanceWeights(7, 9), True, True) == (Pass(True, True, 1.0),)


@pytest.mark.parametrize("weight", [float("nan"), float("inf")])
def test_weights_must_be_finite(weight: float) -> None:
    with pytest.raises(ValueError, match="finite number"):
        GuidanceWeights(constraint=weight)
