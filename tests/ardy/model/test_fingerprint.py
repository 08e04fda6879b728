"""The fingerprint of a model: equal for equal weights and options, different for others."""

from __future__ import annotations

from dataclasses import replace

import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.fingerprint import fingerprint
from tests.ardy.conftest import GoldenModel


def test_the_same_weights_have_the_same_fingerprint(golden: GoldenModel) -> None:
    one, other = (load_checkpoint(golden.folder / "checkpoint") for _ in range(2))
    assert fingerprint(one) == fingerprint(other)


def test_other_weights_or_sampling_options_have_another_fingerprint(golden: GoldenModel) -> None:
    model = load_checkpoint(golden.folder / "checkpoint")
    before = fingerprint(model)
    with torch.no_grad():
        next(model.denoiser.parameters()).mul_(1.001)
    after = fingerprint(model)
    assert after != before
    guidance = replace(model.sampling.guidance, text=model.sampling.guidance.text / 2)
    model.sampling = replace(model.sampling, guidance=guidance)
    assert fingerprint(model) not in (before, after)
