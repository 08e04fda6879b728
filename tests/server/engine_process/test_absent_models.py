"""Models whose weights have changed or that cannot be loaded again: only their own sessions are lost."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from motiongen_server.engine.engine_port import ModelLost
from motiongen_server.engine.types import Closed, CloseReason, SessionKey
from motiongen_server.engine_process import absent_models
from motiongen_server.engine_process.absent_models import AbsentModels
from motiongen_server.engine_process.connection import EngineLost
from motiongen_server.engine_process.control import ControlQueue
from motiongen_server.engine_process.group import EngineGroup
from motiongen_server.engine_process.messages import Ready
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.engine_process.pool import EnginePool
from motiongen_server.engine_process.restarts import LOSSES
from motiongen_server.rpc.abilities import NOTHING_CLAIMED
from motiongen_server.settings import SettingError
from tests.server.engine.fakes import FACTS
from tests.server.engine_process.audience import KEY, LIMIT_S, Audience, opening, pool_of
from tests.waiting import until

OTHER = SessionKey(1, 2)


@dataclass(frozen=True)
class Shelf:
    """Two models on engine processes, each loaded from a file that a test may change or delete."""

    pool: EnginePool
    audience: Audience
    one: EngineGroup
    two: EngineGroup

    def kill(self, number: int = 0) -> None:
        """Kills an engine process, and waits for its replacement."""
        process = self.pool.processes[number]
        before, pid = process.num_restarts, process.pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        until(lambda: process.num_restarts > before)

    def play(self, engine: EngineGroup, key: SessionKey = KEY) -> None:
        """Opens a session of a model as soon as it admits one, and lets it play."""
        until(lambda: engine.submit(opening(key)) is None)
        self.audience.wait_for_frames(20, key)


def put(folder: Path, name: str, weights: str) -> None:
    (folder / name).write_text(weights, encoding="utf-8")


@contextmanager
def shelf(folder: Path, engines: int = 1, rest_s: float = LIMIT_S) -> Iterator[Shelf]:
    for name in ("one", "two"):
        put(folder, name, "as at first")
    with pool_of(f"shelf:{folder}", engines, rest_s=rest_s) as (pool, audience):
        yield Shelf(pool, audience, pool.load("one"), pool.load("two"))


def test_model_whose_weights_changed_is_not_served_but_others_are(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with shelf(tmp_path) as there:
        put(tmp_path, "one", "others")
        there.kill()
        there.play(there.two)
        assert isinstance(there.one.failure, ModelLost)
        assert "'one' holds another model by now than the one that was served as one: reload it" in str(
            there.one.failure
        )
        assert str(tmp_path) not in there.one.failure.told
        assert (there.one.num_engines, there.two.num_engines) == (0, 1)
        process = there.pool.processes[0]
        assert (there.two.failure, process.failure, process.num_restarts) == (None, None, 1)
    assert "engine 0 serves on without a model: 'one' holds another model by now" in caplog.text


def test_model_with_changed_weights_is_served_after_a_reload(tmp_path: Path) -> None:
    with shelf(tmp_path) as there:
        put(tmp_path, "one", "others")
        there.kill()
        until(lambda: there.one.failure)
        anew = there.pool.load("one")
        there.one.stop()
        assert there.one.join(1.0)
        there.play(anew)
        there.kill()
        there.play(anew, OTHER)
        assert anew.failure is None


def test_restored_weights_are_served_by_the_next_process(tmp_path: Path) -> None:
    with shelf(tmp_path) as there:
        put(tmp_path, "one", "others")
        there.kill()
        until(lambda: there.one.failure)
        put(tmp_path, "one", "as at first")
        there.kill()
        there.play(there.one)
        assert there.one.failure is None


def test_model_that_fails_to_load_again_is_retried_while_others_play(tmp_path: Path) -> None:
    with shelf(tmp_path, rest_s=0.1) as there:
        (tmp_path / "one").unlink()
        there.kill()
        there.play(there.two)
        assert "cannot be loaded again, and is tried once more within " in str(there.one.failure)
        assert "cannot serve model 'one'" in str(there.one.failure)
        put(tmp_path, "one", "as at first")
        there.play(there.one, OTHER)
        assert (there.one.failure, there.pool.processes[0].num_restarts) == (None, 1)
        assert there.audience.of(Closed) == []


def test_model_is_served_by_the_engines_that_still_hold_it(tmp_path: Path) -> None:
    with shelf(tmp_path, engines=2) as there:
        there.two.stop()
        assert there.two.join(LIMIT_S)
        put(tmp_path, "one", "others")
        lost = there.pool.processes[1]
        there.kill(1)
        link = there.one._members[1][1]
        until(lambda: link.failure)
        for handle in (1, 2):
            there.play(there.one, SessionKey(1, handle))
        assert (there.pool.processes[0].num_sessions, lost.num_sessions) == (2, 0)
        assert (there.one.failure, there.one.num_engines) == (None, 1)
        assert (lost.failure, lost.num_restarts) == (None, 1)
        there.kill(0)
        until(lambda: there.one.failure)


def test_process_that_can_load_no_model_again_counts_as_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motiongen_server.engine_process.restarts.LOSSES_WITHIN_S", LIMIT_S)
    with shelf(tmp_path, rest_s=0.1) as there:
        for name in ("one", "two"):
            (tmp_path / name).unlink()
        there.kill()
        process = there.pool.processes[0]
        until(lambda: process.num_restarts > LOSSES)
        assert isinstance(process.failure, EngineLost)
        put(tmp_path, "two", "as at first")
        there.play(there.two)
        assert (process.failure, there.two.failure) == (None, None)
        assert isinstance(there.one.failure, ModelLost)
        put(tmp_path, "one", "as at first")
        there.play(there.one, OTHER)


def test_model_stuck_while_loading_again_does_not_affect_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For example because its disk hangs. Loading of a further model is then refused instead of waiting."""
    with shelf(tmp_path) as there:
        put(tmp_path, "two", "stuck")
        there.kill()
        there.play(there.one)
        for module in ("silence", "absent_models", "pool"):
            monkeypatch.setattr(f"motiongen_server.engine_process.{module}.LOAD_AGAIN_S", 1.0)
        failure = until(lambda: there.two.failure)
        assert "'two' has been loading again for" in str(failure)
        with pytest.raises(SettingError, match=r"engine 0 has been loading a model again for \d+ s"):
            there.pool.load("three")
        process = there.pool.processes[0]
        assert (process.num_restarts, there.audience.of(Closed)) == (1, [])
        monkeypatch.undo()
        put(tmp_path, "two", "as at first")
        there.kill()
        there.play(there.two, OTHER)
        assert there.two.failure is None


def test_load_that_hangs_in_one_engine_process_ends_when_another_cannot_load_the_model(tmp_path: Path) -> None:
    put(tmp_path, "three", "stuck")
    with shelf(tmp_path, engines=2) as there, ThreadPoolExecutor(1) as operator:
        try:
            loading = operator.submit(there.pool.load, "three")
            until(lambda: there.pool.processes[0]._control.is_loading)
            there.kill(0)
            assert isinstance(loading.exception(LIMIT_S), EngineLost)
            there.play(there.one)
        finally:
            there.kill(1)


def test_retries_of_loading_become_rarer_with_each_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(absent_models, "time", SimpleNamespace(monotonic=lambda: now[0]))
    held, lost = (ModelLink(slot, f"model-{slot}", lambda outputs: None, lambda: None) for slot in (1, 2))
    control = ControlQueue()
    for link in (held, lost):
        control.add(link)
        link.take_ready(Ready(link.slot, FACTS, "CC0-1.0", NOTHING_CLAIMED))
    lost.lose(CloseReason.ENGINE_FAULT, "it was killed")
    absent = AbsentModels("0", control, 30.0)

    def rested_s() -> float:
        """How long it takes until loading is tried again."""
        control.take()
        absent.fail(lost, "the disk is away")
        begun_at = now[0]
        while not control.take():
            now[0] += 1.0
            absent.look(0.0)
        return now[0] - begun_at

    assert [rested_s() for _ in range(7)] == [30.0, 60.0, 120.0, 240.0, 480.0, 600.0, 600.0]
    absent.begin()
    assert rested_s() == 30.0
