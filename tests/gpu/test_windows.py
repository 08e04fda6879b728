"""Windows of the built-in model on a CUDA device match those of the processor, alone, in batches and as graphs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.precision import PRECISIONS
from motiongen_server.engine.scheduling.warm_up import warm_up
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.loading import graphs_for
from tests.bench.gpu_parity import measured_on
from tests.steered_jobs import MINI, all_kinds, played

pytestmark = pytest.mark.gpu


def test_windows_match_the_processors_alone_and_in_batches() -> None:
    rows = measured_on("cuda")
    assert all(row.holds for row in rows), rows


@pytest.mark.parametrize("precision", list(PRECISIONS))
def test_replayed_windows_match_called_ones(precision: str) -> None:
    model = load_checkpoint(MINI, "cuda")
    called = TorchRunner(model, "called", precision=PRECISIONS[precision])
    graphs = graphs_for("cuda")
    assert graphs is not None
    replayed = TorchRunner(model, "replayed", precision=PRECISIONS[precision], graphs=graphs)
    begun = played(called, all_kinds(model))
    for jobs in (all_kinds(model), all_kinds(model, begun), [replace(all_kinds(model, begun)[1], job_id=20)]):
        with replayed.recording_at_once():
            made = played(replayed, jobs)
        for mine, other in zip(made, played(called, jobs), strict=True):
            # Padded batches may add in another order, and a latent may round to another code.
            assert np.abs(mine.frames[:, :3] - other.frames[:, :3]).max() < 0.05
            turned = np.minimum(*(np.abs(mine.frames[:, 3:] - sign * other.frames[:, 3:]) for sign in (1, -1)))
            assert np.median(turned) < 0.01
    recorded = graphs.num_recorded
    played(replayed, all_kinds(model))
    assert graphs.num_recorded == recorded > 0


def test_every_size_is_recorded_once() -> None:
    model, graphs = load_checkpoint(MINI, "cuda"), graphs_for("cuda")
    assert graphs is not None
    runner = TorchRunner(model, "warm", precision=PRECISIONS["bfloat16"], graphs=graphs)
    recorded = []
    for _ in range(2):
        with runner.recording_at_once():
            assert warm_up(runner, (1, 2, 12, 16), 16) == 16
        recorded.append(graphs.num_recorded)
    assert recorded[1] == recorded[0] > 0
