"""Decoding that is replayed as a graph gives what decoding gives, and nothing in it waits for the device."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.sampling import flips, landings, seams
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.decoding import asked_of
from tests.steered_jobs import MINI, all_kinds, played

TINY = Path(__file__).parents[2] / "data" / "golden" / "tiny-core27" / "checkpoint"
COPIED_OR_AWAITED = ("aten.lift_fresh", "aten._local_scalar_dense", "aten.nonzero", "aten.item", "aten.is_nonzero")


class NothingAwaited(TorchDispatchMode):
    """Fails where a GPU would be waited for, or something copied to it, which cannot be recorded.

    What the processor alone asks, since it is cheap there, is named in `allowed`.
    """

    def __init__(self, allowed: int) -> None:
        super().__init__()
        self.allowed = allowed

    def __torch_dispatch__(self, operation: Any, types: Any, given: Any = (), named: Any = None) -> Any:
        if str(operation).startswith(COPIED_OR_AWAITED):
            self.allowed -= 1
            assert self.allowed >= 0, f"{operation} in what is recorded"
        return operation(*given, **(named or {}))


class Recorder:
    """Does the work again where a graph would be replayed. The second time it must not wait: its tables are made."""

    def __init__(self, allowed: int) -> None:
        self.allowed = allowed
        self.num_replays = 0

    def record(self, work: Callable[[], Any]) -> tuple[Callable[[], None], Any]:
        first = work()
        result = first.clone() if isinstance(first, Tensor) else tuple(part.clone() for part in first)

        def replay() -> None:
            self.num_replays += 1
            with NothingAwaited(self.allowed):
                again = work()
            for held, part in zip(
                *(([one] if isinstance(one, Tensor) else one) for one in (result, again)), strict=True
            ):
                held.copy_(part)

        return replay, result


def as_on_a_gpu(touched: Tensor) -> list[int]:
    return list(range(1, touched.shape[1]))


@pytest.mark.parametrize("folder", [MINI, TINY], ids=["mini", "tiny"])
def test_replayed_windows_are_those_that_are_decoded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_checkpoint(folder)
    recorder = Recorder(allowed=1)  # on the processor position tables look whether they reach so far
    plain, replayed = TorchRunner(model, "plain"), TorchRunner(model, "replayed", recorder=recorder)
    first = all_kinds(model)
    begun = played(plain, first)
    for jobs in (first, all_kinds(model, begun)):
        before, expected = recorder.num_replays, played(plain, jobs)
        with monkeypatch.context() as patch:
            patch.setattr(seams, "_joints_of", as_on_a_gpu)
            patch.setattr(flips, "_rows_of", lambda far: None)
            patch.setattr(landings, "_all_in_time", lambda missing: False)
            found = played(replayed, jobs)
        for mine, other in zip(found, expected, strict=True):
            assert np.array_equal(mine.frames, other.frames)
            assert np.array_equal(mine.features, other.features)
        assert recorder.num_replays > before


def test_rows_say_what_they_are_asked_for() -> None:
    model = load_checkpoint(MINI)
    runner = TorchRunner(model, "mini")
    jobs = all_kinds(model)
    runner.prepare(jobs)
    asked = [asked_of(runner.row(job.job_id)) for job in jobs]
    assert asked == ["nothing", "root", "root", "joints", "joints", "joints"]
