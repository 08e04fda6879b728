"""Every stage of the runner works on one device: tensors elsewhere are first brought to where its weights are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.constants import constant
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed import linear
from motiongen_ardy.model.sampling.plan import plan_window
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.targets import job_targets
from tests.pretend_device import AWAY, MixedDevices, carry_away, pretended
from tests.steered_jobs import MINI, all_kinds, played

TINY = Path(__file__).parents[2] / "data" / "golden" / "tiny-core27" / "checkpoint"


@pytest.fixture(autouse=True)
def _forget_tables_on_the_pretended_device() -> Iterator[None]:
    yield
    constant.cache_clear()


def away(folder: Path) -> Model:
    model = load_checkpoint(folder)
    carry_away(model)
    return model


@pytest.mark.parametrize("folder", [MINI, TINY], ids=["mini", "tiny"])
def test_no_kind_of_window_mixes_devices(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "_onednn_takes", lambda weight: False)  # a device has no such kernels
    here, there = load_checkpoint(folder), away(folder)
    expected = TorchRunner(here, "here")
    first = all_kinds(here)
    begun = played(expected, first)
    going_on = all_kinds(here, begun)
    with pretended():
        runner = TorchRunner(there, "there")
        got = played(runner, first) + played(runner, going_on)
        features = runner.features(begun[0].frames[:8])
    for mine, other in zip(got, begun + played(expected, going_on), strict=True):
        assert mine.frames == pytest.approx(other.frames, abs=1e-4)
    assert features == pytest.approx(expected.features(begun[0].frames[:8]), abs=1e-4)


def test_window_is_planned_from_a_history_on_any_device() -> None:
    model, here = away(MINI), load_checkpoint(MINI)
    waypoint = all_kinds(here, played(TorchRunner(here, "here"), all_kinds(here)))[1]
    text = torch.zeros(model.config.denoiser.text_tokens, model.config.denoiser.text_dim)
    targets, history = job_targets(model.skeleton, waypoint), torch.from_numpy(waypoint.history)
    with pretended():
        for given in (history, history.to(AWAY)):
            plan = plan_window(model, targets, text, given, 40)
            assert plan.targets is not None
            assert plan.targets.planned


def test_the_pretended_device_refuses_what_a_gpu_would() -> None:
    with pretended():
        there, here = torch.ones(3, device=AWAY), torch.ones(3)
        assert (there + 1).sum().item() == 6.0
        assert (there.cpu() + here).tolist() == [2.0, 2.0, 2.0]
        with pytest.raises(MixedDevices, match="CPU"):
            there + here
