"""Errors of a device reach the engine as those of the runner's port, and leave jobs as they were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed import PackedDenoiser
from motiongen_ardy.model.packed.graph_cache import RecordingFailed
from motiongen_server.engine.ports import DeviceLost, OutOfMemory
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.device_errors import device_errors
from tests.parity.conftest import make_job

TINY = Path(__file__).parents[2] / "data" / "golden" / "tiny-core27" / "checkpoint"


@pytest.fixture(scope="module")
def model() -> Model:
    return load_checkpoint(TINY)


@pytest.mark.parametrize(
    ("raised", "expected"),
    [
        (torch.OutOfMemoryError("CUDA out of memory"), OutOfMemory),
        (MemoryError(), OutOfMemory),
        (RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory"), OutOfMemory),
        (torch.AcceleratorError("CUDA error: out of memory", 2), OutOfMemory),
        (RecordingFailed("a CUDA graph could not be recorded"), DeviceLost),
        (torch.AcceleratorError("CUDA error: an illegal memory access was encountered", 700), DeviceLost),
        (RuntimeError("mat1 and mat2 shapes cannot be multiplied"), RuntimeError),
        (ValueError("no"), ValueError),
    ],
)
def test_device_errors_are_translated_for_the_engine(raised: Exception, expected: type[Exception]) -> None:
    with pytest.raises(expected) as caught, device_errors():
        raise raised
    assert type(caught.value) is expected


def test_graphs_are_dropped_when_memory_runs_out() -> None:
    let_go = []
    for error in (
        torch.OutOfMemoryError("CUDA out of memory"), torch.AcceleratorError("CUDA error: out of memory", 2)
    ):  # fmt: skip
        with pytest.raises(OutOfMemory), device_errors(lambda: let_go.append("graphs")):
            raise error
    with pytest.raises(ValueError, match="no"), device_errors(lambda: let_go.append("nothing")):
        raise ValueError("no")
    assert let_go == ["graphs"] * 2


def test_failed_allocation_of_torch_is_out_of_memory() -> None:
    with pytest.raises(OutOfMemory), device_errors():
        torch.empty(1 << 50, dtype=torch.float64)


def test_step_that_runs_out_of_memory_leaves_its_jobs_unchanged(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    runner, undisturbed = TorchRunner(model, "tiny"), TorchRunner(model, "tiny")
    jobs = [make_job(number, model, np.random.default_rng(number)) for number in (1, 2)]
    for one in (runner, undisturbed):
        one.prepare(jobs)
    with monkeypatch.context() as patch:
        patch.setattr(PackedDenoiser, "predict", _out_of_memory)
        with pytest.raises(OutOfMemory):
            runner.denoise([1, 2])
    steps = {status.job_id: status.steps_done for status in runner.denoise([2, 1])}
    assert steps == {1: 1, 2: 1}
    undisturbed.denoise([1, 2])
    for job in jobs:
        for one in (runner, undisturbed):
            for _ in range(job.num_steps - 1):
                one.denoise([job.job_id])
    expected = undisturbed.decode([1, 2])
    for result, other in zip(runner.decode([1, 2]), expected, strict=True):
        assert np.array_equal(result.frames, other.frames)


def _out_of_memory(*_: object) -> None:
    raise torch.OutOfMemoryError("no more")
