"""What engine processes are told by the pool that starts them, and which of them are given sessions."""

from __future__ import annotations

import math

import pytest

from motiongen_server.engine.types import SessionKey
from motiongen_server.settings import SettingError
from tests.server.engine_process.audience import opening, pool_of, remote


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two cores, however many this machine has."""
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr("motiongen_server.devices.quota_cores", lambda: math.inf)


@pytest.mark.parametrize(("engines", "given", "load"), [(2, None, "0.87"), (3, None, "0.87"), (3, 0.5, "0.5")])
def test_engines_are_told_the_load_up_to_which_sessions_are_admitted(
    engines: int, given: float | None, load: str
) -> None:
    with pool_of("tell_load", engines, admit_load=given) as (pool, _), pytest.raises(SettingError, match=load):
        pool.load("one")


def test_engines_that_loaded_different_weights_do_not_serve_together() -> None:
    """If a model is replaced during loading, a character's motion would depend on which engine it is given to."""
    with pool_of("changing", 2) as (pool, _):
        with pytest.raises(SettingError, match="'one' was changed while it was loaded"):
            pool.load("one")
        assert [process.num_sessions for process in pool.processes] == [0, 0]


def test_text_of_a_pool_gives_the_device_and_threads_of_its_engine() -> None:
    """`Application` logs the text of its engines: see `tests/server/test_app.py`."""
    with pool_of(engines=1, threads=2) as (pool, _):
        assert str(pool) == "engines on 0: cpu x 2"


def test_engine_for_which_no_core_is_left_gets_no_session(caplog: pytest.LogCaptureFixture) -> None:
    with remote(engines=3) as there:
        with there.stopped():  # no load is reported meanwhile, which on a busy machine would differ between them
            for number in range(4):
                assert there.engine.submit(opening(SessionKey(1, number))) is None
        assert [process.num_sessions for process in there.pool.processes] == [2, 2, 0]
    assert "2: cpu x 1 (spare)" in caplog.text
    assert "1: cpu x 1," in caplog.text
