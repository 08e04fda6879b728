"""Windows of the built-in model on a CUDA device are those of the processor, alone, in company, called and replayed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.precision import PRECISIONS
from motiongen_server.engine.scheduling.warm_up import warm_up
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.loading import load_runner, recorder_for
from tests.bench.gpu_parity import measured_on
from tests.steered_jobs import MINI, all_kinds, played

pytestmark = pytest.mark.gpu


def test_windows_are_those_of_the_processor_alone_and_in_company() -> None:
    rows = measured_on("cuda")
    assert all(row.holds for row in rows), rows


@pytest.mark.parametrize("precision", list(PRECISIONS))
def test_replayed_windows_are_those_that_are_called(precision: str) -> None:
    model = load_checkpoint(MINI, "cuda")
    called = TorchRunner(model, "called", precision=PRECISIONS[precision])
    replayed = TorchRunner(model, "replayed", precision=PRECISIONS[precision], recorder=recorder_for("cuda"))
    begun = played(called, all_kinds(model))
    for jobs in (all_kinds(model), all_kinds(model, begun), [replace(all_kinds(model, begun)[1], job_id=20)]):
        for mine, other in zip(played(replayed, jobs), played(called, jobs), strict=True):
            # Products of batches that are filled up may add in another order, and a code may fall otherwise.
            assert np.abs(mine.frames[:, :3] - other.frames[:, :3]).max() < 0.05


def test_every_size_is_recorded_once() -> None:
    runner = load_runner("motiongen-mini", "cuda", precision="bfloat16", cuda_graphs=True)
    assert warm_up(runner, (1, 2, 12, 16), 16) == 16
