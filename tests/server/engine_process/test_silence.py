"""How long the models of an engine process may be silent, and how long they may take to be loaded again."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from motiongen_server.engine_process import silence
from motiongen_server.engine_process.connection import EngineLost
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.engine_process.silence import LOAD_AGAIN_S, Silence

LOOK_S = 1.0


class Ready(ModelLink):
    """A model that is up once the test says so."""

    def __init__(self, slot: int, *, was_held: bool) -> None:
        super().__init__(slot, "fake", lambda outputs: None, lambda: None)
        if was_held:
            self.ready.set_result(None)  # type: ignore[arg-type]

    def come(self) -> None:
        self._is_up = True


class Watch:
    """Looks once a second, by a clock of its own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *links: ModelLink) -> None:
        self.now = 100.0
        monkeypatch.setattr(silence, "time", SimpleNamespace(monotonic=lambda: self.now))
        self.silence = Silence(links, LOOK_S)

    def look_for(self, seconds: float) -> None:
        """Raises EngineLost."""
        for _ in range(int(seconds / LOOK_S)):
            self.now += LOOK_S
            self.silence.look()
            self.silence.check(30.0)


def test_process_whose_models_do_not_come_back_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Watch(monkeypatch, Ready(1, was_held=True))
    watch.look_for(LOAD_AGAIN_S)
    with pytest.raises(EngineLost, match="loading again what the one before it held for 60"):
        watch.look_for(5.0)


def test_model_that_does_not_come_back_is_tolerated_while_another_is_served(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stuck, served = Ready(1, was_held=True), Ready(2, was_held=True)
    watch = Watch(monkeypatch, stuck, served)
    served.come()
    for _ in range(60):
        watch.look_for(LOAD_AGAIN_S / 30)
        served.silent_s = 0.0  # as it keeps sending reports
    assert watch.silence.missing_s > LOAD_AGAIN_S


def test_every_model_that_comes_back_gives_the_others_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = Ready(1, was_held=True), Ready(2, was_held=True)
    watch = Watch(monkeypatch, first, second)
    watch.look_for(0.9 * LOAD_AGAIN_S)
    first.come()
    for _ in range(27):
        watch.look_for(LOAD_AGAIN_S / 30)
        first.silent_s = 0.0  # as it keeps sending reports
    second.come()
    watch.look_for(20.0)
    with pytest.raises(EngineLost, match="said nothing for 3"):
        watch.look_for(20.0)


def test_absent_model_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    absent = Ready(1, was_held=True)
    watch = Watch(monkeypatch, absent)
    absent.is_absent = True
    watch.look_for(2 * LOAD_AGAIN_S)
    absent.is_absent = False  # loading is tried again
    with pytest.raises(EngineLost, match="loading again"):
        watch.look_for(LOAD_AGAIN_S + 5.0)


def test_model_that_was_never_loaded_may_take_any_time(monkeypatch: pytest.MonkeyPatch) -> None:
    Watch(monkeypatch, Ready(1, was_held=False)).look_for(3 * LOAD_AGAIN_S)


def test_silence_is_measured_by_time_and_not_by_the_number_of_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is a look for every message of an engine process, whichever model it concerns."""
    talking, working = Ready(1, was_held=True), Ready(2, was_held=True)
    watch = Watch(monkeypatch, talking, working)
    talking.come()
    working.come()
    for _ in range(4000):
        watch.now += LOOK_S / 256
        watch.silence.look()
        watch.silence.check(30.0)
    assert working.silent_s == 4000 * LOOK_S / 256
    watch.now += 100 * LOOK_S  # this process was suspended
    watch.silence.look()
    assert working.silent_s == 4000 * LOOK_S / 256 + LOOK_S
