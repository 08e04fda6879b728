"""The runner gives the same windows with and without graphs, whatever was replayed in between."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed import PackedDenoiser
from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_ardy.model.sampling import flips, landings, seams
from motiongen_ardy.model.transformer import PositionTable
from motiongen_server.engine.ports import OutOfMemory
from motiongen_server.engine.types import VELOCITY_ID, Guidance, RootTrajectory, Waypoint, WindowJob, WindowResult
from motiongen_server.runner import TorchRunner, decoding
from motiongen_server.runner.decoding import asked_of
from tests.steered_jobs import MINI, all_kinds, job, played
from tests.taped import TapeRecorder, eager

TINY = Path(__file__).parents[2] / "data" / "golden" / "tiny-core27" / "checkpoint"


@pytest.fixture
def as_on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skips shortcuts that only the CPU takes, since they are cheap there; what comes to the host is a copy."""
    on_host = decoding.on_host
    monkeypatch.setattr(decoding, "on_host", lambda *tensors: [part.copy() for part in on_host(*tensors)])
    monkeypatch.setattr(seams, "_joints_of", lambda touched: list(range(1, touched.shape[1])))
    monkeypatch.setattr(flips, "_rows_of", lambda far: None)
    monkeypatch.setattr(landings, "_all_in_time", lambda missing: False)
    monkeypatch.setattr(PositionTable, "checked", lambda table, positions: positions - table.lowest)


def assert_same(found: Sequence[WindowResult], expected: Sequence[WindowResult]) -> None:
    for mine, other in zip(found, expected, strict=True):
        assert np.array_equal(mine.frames, other.frames)
        assert np.array_equal(mine.features, other.features)


def led(model: Model) -> WindowJob:
    """A first window with a root trajectory from its first frame on, including headings."""
    way = np.linspace((1.0, -2.0), (1.3, 0.0), 40, dtype=np.float32)
    leading = RootTrajectory(VELOCITY_ID, 0, way, np.full(40, 0.15, np.float32))
    return replace(all_kinds(model)[2], constraints=(leading,))


@pytest.mark.parametrize("folder", [MINI, TINY], ids=["mini", "tiny"])
@pytest.mark.usefixtures("as_on_a_gpu")
def test_replayed_windows_equal_those_without_graphs(folder: Path) -> None:
    model, recorder = load_checkpoint(folder), TapeRecorder()
    plain, replayed = TorchRunner(model, "plain"), TorchRunner(model, "replayed", graphs=eager(recorder))
    first = all_kinds(model)
    begun = played(plain, first)
    for jobs in (first, all_kinds(model, begun)):
        before, expected = recorder.num_replays, played(plain, jobs)
        assert_same(played(replayed, jobs), expected)
        assert recorder.num_replays > before


@pytest.mark.usefixtures("as_on_a_gpu")
def test_step_replays_one_graph_per_sequence_length_and_one_for_the_rest() -> None:
    model, recorder = load_checkpoint(TINY), TapeRecorder()
    plain, replayed = TorchRunner(model, "plain"), TorchRunner(model, "replayed", graphs=eager(recorder))
    [history] = (one.features[-16:] for one in played(plain, all_kinds(model)[:1]))
    waypoint, beyond = ((Waypoint(1, frame, 1.0, 1.0),) for frame in (60, 90))  # within the window, and beyond it
    for asked, num_lengths in (((), ()), 1), (((), waypoint, ()), 1), (((), beyond, waypoint), 2), (((), ()), 1):
        jobs = [job(number, model, history, goals, is_told=True) for number, goals in enumerate(asked, start=1)]
        expected, ids = played(plain, jobs), [one.job_id for one in jobs]
        replayed.prepare(jobs)
        replayed.denoise(ids)
        before = recorder.num_replays
        replayed.denoise(ids)
        assert recorder.num_replays == before + num_lengths + 1
        assert_same(replayed.decode(ids), expected)


@pytest.mark.usefixtures("as_on_a_gpu")
def test_rows_whose_root_is_kept_are_replayed_together_with_others() -> None:
    recorder = TapeRecorder()
    pair = Pair(MINI, torch.float32, eager(recorder))
    jobs = [all_kinds(pair.model)[0], led(pair.model)]
    ids = [one.job_id for one in jobs]
    pair.replayed.prepare(jobs)
    pair.replayed.denoise(ids)
    assert [pair.replayed.row(one).root is None for one in ids] == [True, False]
    before = recorder.num_replays
    pair.replayed.denoise(ids)
    assert recorder.num_replays == before + 2
    assert_same(pair.replayed.decode(ids), played(pair.called, jobs))


class Pair:
    """A runner without graphs and one that replays them, which tests give the same jobs."""

    def __init__(self, folder: Path, precision: torch.dtype, graphs: GraphCache) -> None:
        self.model = load_checkpoint(folder)
        self.called = TorchRunner(self.model, "called", precision=precision)
        self.replayed = TorchRunner(self.model, "replayed", precision=precision, graphs=graphs)

    def tokens(self, job_id: int) -> tuple[Tensor, Tensor]:
        return self.called.row(job_id).tokens, self.replayed.row(job_id).tokens

    def random_jobs(self, numbers: random.Random, kinds: Sequence[WindowJob], first_id: int) -> list[WindowJob]:
        jobs = []
        for job_id in range(first_id, first_id + numbers.randint(1, 3)):
            one = numbers.choice(kinds)
            if len(one.history):
                one = replace(one, history=one.history[-numbers.choice((4, 16)) :])
            if not one.constraints and numbers.random() < 0.3:
                one = replace(one, constraints=(Waypoint(1, one.first_frame + numbers.choice((20, 80)), 1.0, 1.0),))
            guidance = numbers.choice((Guidance(1.5, 1.5), Guidance(1.0, 1.0), Guidance(2.0, 1.0)))
            jobs.append(replace(one, job_id=job_id, num_steps=numbers.choice((2, 3)), guidance=guidance))
        return jobs


@pytest.mark.parametrize(
    ("folder", "most", "worth_it"),
    [(MINI, 64, 1), (TINY, 64, 1), (TINY, 3, 1), (TINY, 64, 3)],
    ids=["mini", "tiny", "few graphs", "of what comes often"],
)
@pytest.mark.usefixtures("as_on_a_gpu")
def test_interleaved_windows_equal_those_without_graphs(folder: Path, most: int, worth_it: int) -> None:
    numbers, recorder = random.Random(7), TapeRecorder()
    pair = Pair(folder, torch.float32, GraphCache(recorder, most, worth_it=worth_it))
    kinds = all_kinds(pair.model) + all_kinds(pair.model, played(pair.called, all_kinds(pair.model)))
    kinds.append(led(pair.model))
    left: dict[int, int] = {}  # steps, by job
    for first_id in range(100, 148, 3):
        if len(left) < 6:
            jobs = pair.random_jobs(numbers, kinds, first_id)
            for runner in (pair.called, pair.replayed):
                runner.prepare(jobs)
            left |= {one.job_id: one.num_steps for one in jobs}
        stepped = [one for one, steps in left.items() if steps and numbers.random() < 0.7]
        for runner in (pair.called, pair.replayed):
            runner.denoise(stepped)
        for one in stepped:
            left[one] -= 1
            assert torch.equal(*pair.tokens(one))
        done = [one for one, steps in left.items() if not steps and numbers.random() < 0.7]
        for one in done:
            del left[one]
        if done:
            assert_same(pair.replayed.decode(done), pair.called.decode(done))
    assert recorder.num_recorded > 3


@pytest.mark.usefixtures("as_on_a_gpu")
def test_graphs_are_dropped_without_memory_and_windows_stay_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recorder = TapeRecorder()
    pair = Pair(TINY, torch.float32, GraphCache(recorder))
    jobs = all_kinds(pair.model)
    with pair.replayed.recording_at_once():
        expected = played(pair.called, jobs)
        assert_same(played(pair.replayed, jobs), expected)
    before = recorder.num_replays
    assert_same(played(pair.replayed, jobs), expected)
    assert recorder.num_replays > before
    pair.replayed.prepare(jobs)
    with monkeypatch.context() as patch:
        patch.setattr(PackedDenoiser, "predict", _out_of_memory)
        with pytest.raises(OutOfMemory):
            pair.replayed.denoise([one.job_id for one in jobs])
    pair.replayed.discard([one.job_id for one in jobs])
    before = recorder.num_replays
    assert_same(played(pair.replayed, jobs), expected)
    assert recorder.num_replays == before


def _out_of_memory(*_: object) -> None:
    raise torch.OutOfMemoryError("no more")


def test_rows_know_which_kind_of_target_they_are_asked_for() -> None:
    model = load_checkpoint(MINI)
    runner = TorchRunner(model, "mini")
    jobs = all_kinds(model)
    runner.prepare(jobs)
    asked = [asked_of(runner.row(job.job_id)) for job in jobs]
    assert asked == ["nothing", "root", "root", "joints", "joints", "joints"]
