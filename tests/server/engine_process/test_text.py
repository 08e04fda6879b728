"""A text encoder in an engine process, as the gateway asks it."""

from __future__ import annotations

import pytest

from motiongen_server.engine_process.text import EncoderLost, EngineTextEncoder
from motiongen_server.settings import SettingError
from tests.server.engine_process.audience import LIMIT_S, pool_of


def test_prompts_are_encoded_there_and_what_cannot_be_is_said() -> None:
    with pool_of() as (pool, _):
        encoder = EngineTextEncoder(pool.processes[0], 2, LIMIT_S)
        assert (encoder.identity, encoder.width) == ("length-1", 2)
        assert encoder.encode(["a", "abc"]).tolist() == [[1.0, 0.0], [3.0, 0.0]]
        with pytest.raises(EncoderLost, match="failed"):
            encoder.encode(["fail"])


def test_a_lost_engine_process_breaks_off_what_is_encoded_and_the_next_encodes_again() -> None:
    with pool_of() as (pool, _):
        encoder = EngineTextEncoder(pool.processes[0], 2, LIMIT_S)
        with pytest.raises(EncoderLost, match="started anew") as lost:
            encoder.encode(["die"])
        assert lost.value.retry_after_s > 0
        assert encoder.encode(["abcd"]).tolist() == [[4.0, 0.0]]


def test_one_that_takes_too_long_is_not_waited_for() -> None:
    with pool_of() as (pool, _):
        encoder = EngineTextEncoder(pool.processes[0], 2, timeout_s=0.0)
        with pytest.raises(EncoderLost, match="longer than 0 s"):
            encoder.encode(["abc"])


def test_one_that_cannot_be_loaded_is_a_wrong_setting() -> None:
    with pool_of("settings") as (pool, _), pytest.raises(SettingError, match="no such encoder"):
        EngineTextEncoder(pool.processes[0], 2, LIMIT_S)
