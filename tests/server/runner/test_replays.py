"""What the runner replays as graphs gives what is given without them, and nothing in it waits for the device."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.sampling import flips, landings, seams
from motiongen_ardy.model.transformer import PositionTable
from motiongen_server.engine.types import Waypoint, WindowResult
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.decoding import asked_of
from tests.steered_jobs import MINI, all_kinds, job, played

TINY = Path(__file__).parents[2] / "data" / "golden" / "tiny-core27" / "checkpoint"
COPIED_OR_AWAITED = ("aten.lift_fresh", "aten._local_scalar_dense", "aten.nonzero", "aten.item", "aten.is_nonzero")


class NothingAwaited(TorchDispatchMode):
    """Fails where a GPU would be waited for, or something copied to it, which cannot be recorded."""

    def __torch_dispatch__(self, operation: Any, types: Any, given: Any = (), named: Any = None) -> Any:
        assert not str(operation).startswith(COPIED_OR_AWAITED), f"{operation} in what is recorded"
        return operation(*given, **(named or {}))


class Recorder:
    """Does the work again where a graph would be replayed. The second time it must not wait: its tables are made."""

    def __init__(self) -> None:
        self.num_replays = 0

    def record(self, work: Callable[[], Any]) -> tuple[Callable[[], None], Any]:
        first = work()
        result = first.clone() if isinstance(first, Tensor) else tuple(part.clone() for part in first)

        def replay() -> None:
            self.num_replays += 1
            with NothingAwaited():
                again = work()
            for held, part in zip(
                *(([one] if isinstance(one, Tensor) else one) for one in (result, again)), strict=True
            ):
                held.copy_(part)

        return replay, result


@pytest.fixture
def as_on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the processor alone asks, since it is cheap there, is not asked."""
    monkeypatch.setattr(seams, "_joints_of", lambda touched: list(range(1, touched.shape[1])))
    monkeypatch.setattr(flips, "_rows_of", lambda far: None)
    monkeypatch.setattr(landings, "_all_in_time", lambda missing: False)
    monkeypatch.setattr(PositionTable, "checked", lambda table, positions: positions - table.lowest)


def assert_same(found: Sequence[WindowResult], expected: Sequence[WindowResult]) -> None:
    for mine, other in zip(found, expected, strict=True):
        assert np.array_equal(mine.frames, other.frames)
        assert np.array_equal(mine.features, other.features)


@pytest.mark.parametrize("folder", [MINI, TINY], ids=["mini", "tiny"])
@pytest.mark.usefixtures("as_on_a_gpu")
def test_replayed_windows_are_those_that_are_called(folder: Path) -> None:
    model, recorder = load_checkpoint(folder), Recorder()
    plain, replayed = TorchRunner(model, "plain"), TorchRunner(model, "replayed", recorder=recorder)
    first = all_kinds(model)
    begun = played(plain, first)
    for jobs in (first, all_kinds(model, begun)):
        before, expected = recorder.num_replays, played(plain, jobs)
        assert_same(played(replayed, jobs), expected)
        assert recorder.num_replays > before


@pytest.mark.usefixtures("as_on_a_gpu")
def test_a_step_is_a_replay_for_each_length_of_sequences_and_one_for_what_follows() -> None:
    model, recorder = load_checkpoint(TINY), Recorder()
    plain, replayed = TorchRunner(model, "plain"), TorchRunner(model, "replayed", recorder=recorder)
    [history] = (one.features[-16:] for one in played(plain, all_kinds(model)[:1]))
    waypoint, beyond = ((Waypoint(1, frame, 1.0, 1.0),) for frame in (60, 90))  # within the window, and behind it
    for asked, num_lengths in (((), ()), 1), (((), waypoint, ()), 1), (((), beyond, waypoint), 2), (((), ()), 1):
        jobs = [job(number, model, history, goals, is_told=True) for number, goals in enumerate(asked, start=1)]
        expected, ids = played(plain, jobs), [one.job_id for one in jobs]
        replayed.prepare(jobs)
        replayed.denoise(ids)
        before = recorder.num_replays
        replayed.denoise(ids)
        assert recorder.num_replays == before + num_lengths + 1
        assert_same(replayed.decode(ids), expected)


def test_rows_say_what_they_are_asked_for() -> None:
    model = load_checkpoint(MINI)
    runner = TorchRunner(model, "mini")
    jobs = all_kinds(model)
    runner.prepare(jobs)
    asked = [asked_of(runner.row(job.job_id)) for job in jobs]
    assert asked == ["nothing", "root", "root", "joints", "joints", "joints"]
