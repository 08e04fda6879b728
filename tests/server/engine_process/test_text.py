"""A text encoder in an engine process, as the gateway uses it."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from motiongen_server.engine_process.messages import Encoded, EncoderReady, EncodeTexts, ToEngine
from motiongen_server.engine_process.process import EngineProcess, TakeText
from motiongen_server.engine_process.text import EncoderLost, EngineTextEncoder
from motiongen_server.settings import SettingError
from tests.server.engine_process.audience import LIMIT_S, opening, pool_of, remote, stop, stopped
from tests.waiting import until


def test_texts_are_encoded_and_a_failure_is_raised() -> None:
    with pool_of() as (pool, _):
        encoder = EngineTextEncoder(pool.processes[0], 2, LIMIT_S)
        assert (encoder.identity, encoder.width) == ("length-1", 2)
        assert encoder.encode(["a", "abc"]).tolist() == [[1.0, 0.0], [3.0, 0.0]]
        with pytest.raises(EncoderLost, match="failed"):
            encoder.encode(["fail"])


def test_lost_engine_process_fails_pending_texts_and_the_next_encodes_again() -> None:
    with pool_of() as (pool, _):
        encoder = EngineTextEncoder(pool.processes[0], 2, LIMIT_S)
        with pytest.raises(EncoderLost, match="started anew") as lost:
            encoder.encode(["die"])
        assert lost.value.retry_after_s > 0
        assert encoder.encode(["abcd"]).tolist() == [[4.0, 0.0]]


def test_encoder_that_takes_too_long_is_not_waited_for() -> None:
    with pool_of() as (pool, _):
        encoder = EngineTextEncoder(pool.processes[0], 2, timeout_s=0.01)
        pid = pool.processes[0].pid
        assert pid is not None
        with stopped(pid), pytest.raises(EncoderLost, match=r"longer than 0\.01 s"):
            encoder.encode(["abc"])


def test_encoder_that_cannot_be_loaded_is_a_setting_error() -> None:
    with pool_of("settings") as (pool, _), pytest.raises(SettingError, match="no such encoder"):
        EngineTextEncoder(pool.processes[0], 2, LIMIT_S)


def test_encoder_without_enough_memory_does_not_affect_models_of_its_process() -> None:
    with remote("large encoder") as there:
        with pytest.raises(SettingError, match="MemoryError: 15 GiB"):
            EngineTextEncoder(there.pool.processes[0], 2, LIMIT_S)
        there.engine.submit(opening())
        there.audience.wait_for_frames(1)
        assert there.pool.processes[0].num_restarts == 0


def test_encoder_stuck_while_loading_again_does_not_block_loading_for_ever(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """For example because a driver or a disk hangs: the encoder is loaded by the thread that loads models."""
    with remote(f"stuck encoder:{tmp_path}", text_encoder="llm2vec") as there:
        there.pool.load_text(there.engine.facts)
        process, pid = there.pool.processes[0], there.pid()
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        until(lambda: process.num_restarts == 1 and len(list(tmp_path.iterdir())) == 2)
        until(lambda: there.engine.num_engines and not process.absent.awaited_s)
        monkeypatch.setattr("motiongen_server.engine_process.pool.LOAD_AGAIN_S", 0.1)
        with pytest.raises(
            SettingError, match=r"engine 0 has been loading the text encoder again for \d+ s, and loads"
        ):
            there.pool.load("another")
        until(lambda: there.engine.submit(opening()) is None)
        there.audience.wait_for_frames(20)
        assert [link.source for link in process._control] == ["fake"]
        stuck = there.pid()
        assert stuck is not None
        os.kill(stuck, signal.SIGKILL)  # as the refusal says
        until(lambda: process.num_restarts == 2 and there.engine.num_engines)
        monkeypatch.undo()
        there.pool.load("another")


def test_stopped_process_fails_pending_texts_and_later_ones() -> None:
    refused: list[EncoderLost] = []

    def ask(encoder: EngineTextEncoder) -> None:
        try:
            encoder.encode(["abc"])
        except EncoderLost as error:
            refused.append(error)

    with pool_of() as (pool, _):
        encoder = EngineTextEncoder(pool.processes[0], 2, LIMIT_S)
        pid = pool.processes[0].pid
        assert pid is not None
        stop(pid)  # it answers nothing, and `join` kills it
        asking = threading.Thread(target=ask, args=(encoder,))
        asking.start()
        until(lambda: encoder._waiting)
        pool.stop()
        assert pool.join(0.0)
        asking.join(LIMIT_S / 2)
        assert len(refused) == 1
        with pytest.raises(EncoderLost, match="has ended"):
            encoder.encode(["abc"])
        with pytest.raises(SettingError, match="was lost"):
            EngineTextEncoder(pool.processes[0], 2, LIMIT_S)


class Process:
    """Stands in for an engine process that sends what the test tells it to."""

    failure = None

    def serve_text(
        self, take: TakeText, on_begin: Callable[[], Sequence[ToEngine]], on_loss: Callable[[], None]
    ) -> None:
        self.say, self.is_lost = take, on_loss
        take(EncoderReady("length-1", 2, ""))

    def tell(self, message: ToEngine) -> bool:
        assert isinstance(message, EncodeTexts)
        self.say(Encoded(message.number, np.ones((1, 2), np.float32), ""))
        return True


def test_encoder_that_cannot_be_loaded_again_fails_until_the_next_process() -> None:
    process = Process()
    encoder = EngineTextEncoder(cast(EngineProcess, process), 2, LIMIT_S)
    process.is_lost()
    process.say(EncoderReady("", 0, "its folder is gone"))
    with pytest.raises(EncoderLost, match="could not be loaded again"):
        encoder.encode(["abc"])
    process.is_lost()
    process.say(EncoderReady("length-1", 2, ""))
    assert encoder.encode(["abc"]).tolist() == [[1.0, 1.0]]


def test_encoder_with_another_identity_is_refused_until_the_first_is_back(caplog: pytest.LogCaptureFixture) -> None:
    """Vectors are cached under the identity of the earlier encoder, on disk too."""
    process = Process()
    encoder = EngineTextEncoder(cast(EngineProcess, process), 2, LIMIT_S)
    process.is_lost()
    process.say(EncoderReady("length-2", 2, ""))
    with pytest.raises(EncoderLost, match="'length-2' now, and was 'length-1'"):
        encoder.encode(["abc"])
    assert "restart the server" in caplog.text
    process.is_lost()
    process.say(EncoderReady("length-1", 2, ""))
    assert encoder.encode(["abc"]).tolist() == [[1.0, 1.0]], "the first encoder is back"


def test_encoder_replaced_at_the_moment_of_a_question_is_refused() -> None:
    process = Process()
    encoder = EngineTextEncoder(cast(EngineProcess, process), 2, LIMIT_S)

    def number_late() -> int:
        process.is_lost()
        process.say(EncoderReady("length-2", 2, ""))
        return 1

    encoder._numbers = iter(number_late, None)  # type: ignore[assignment]
    with pytest.raises(EncoderLost, match="'length-2' now, and was 'length-1'"):
        encoder.encode(["abc"])
