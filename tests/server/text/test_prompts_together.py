"""Texts of one caller that are encoded in one batch: how many, and the outcome of each."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from motiongen_ardy.text.encoder import PromptNotEncoded, TextEncoderUnavailable
from motiongen_server.errors import EventRefused
from motiongen_server.text.prompts import MOST_TOGETHER, TOGETHER_S, PromptEncoder
from motiongen_server.text.turns import Asker
from tests.server.text.test_prompts import DictStore


class Timed:
    """An encoder that advances a clock by text_s for each text, and fails for the texts in `errors`."""

    identity = "timed-1"

    def __init__(self, text_s: float) -> None:
        self.text_s = text_s
        self.now_s = 0.0
        self.calls: list[tuple[str, ...]] = []
        self.errors: dict[str, Exception] = {}

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        self.calls.append(tuple(texts))
        self.now_s += self.text_s * len(texts)
        for text in texts:
            if text in self.errors:
                raise self.errors[text]
        return np.array([[len(text)] for text in texts], np.float32)

    def prompts(self, store: DictStore | None = None) -> PromptEncoder:
        return PromptEncoder(self, 100, store=store, clock=lambda: self.now_s)


NUMBERS = [f"number {number}" for number in range(40)]


async def test_fast_encoder_gets_several_texts_of_a_caller_in_one_batch() -> None:
    encoder = Timed(TOGETHER_S / 4)
    prompts = encoder.prompts()
    found = await prompts.encode_all([*NUMBERS[:10], *NUMBERS[:3]])
    assert list(found) == NUMBERS[:10]
    assert all(found[text] is prompts.cached(text) for text in NUMBERS[:10])
    assert [len(call) for call in encoder.calls] == [1, 4, 4, 1], (
        "as many as fit into the time for which others may wait"
    )
    encoder.text_s = 1e-6
    await prompts.encode("another")
    await prompts.encode_all(["number 3", *NUMBERS[10:]])
    assert [len(call) for call in encoder.calls[4:]] == [1, MOST_TOGETHER, 30 - MOST_TOGETHER]
    prompts.close()


async def test_slow_encoder_gets_one_text_at_a_time() -> None:
    encoder = Timed(TOGETHER_S)
    prompts = encoder.prompts()
    await prompts.encode_all(NUMBERS[:5])
    assert encoder.calls == [(text,) for text in NUMBERS[:5]]
    prompts.close()


async def quick(encoder: Timed, store: DictStore | None = None) -> PromptEncoder:
    """A prompt encoder whose encoder has proven fast, so that its batches are as large as allowed."""
    prompts = encoder.prompts(store)
    await prompts.encode("first")
    encoder.calls.clear()
    return prompts


async def test_text_that_cannot_be_encoded_fails_alone() -> None:
    encoder = Timed(1e-6)
    prompts = await quick(encoder)
    encoder.errors = {NUMBERS[1]: PromptNotEncoded("not that one"), NUMBERS[2]: RuntimeError("the encoder broke")}
    asked = asyncio.create_task(prompts.encode_all(NUMBERS[:4], Asker("hostile")))
    await asyncio.sleep(0)  # it is waiting now
    results = await asyncio.gather(*(prompts.encode(text) for text in NUMBERS[:4]), return_exceptions=True)
    assert encoder.calls == [tuple(NUMBERS[:4]), *((text,) for text in NUMBERS[:4])]
    assert isinstance(results[1], EventRefused)
    assert isinstance(results[2], RuntimeError)
    for number in (0, 3):
        np.testing.assert_array_equal(results[number], [len(NUMBERS[number])])
    with pytest.raises(EventRefused, match="not that one"):
        await asked
    prompts.close()


async def test_unavailable_encoder_is_called_once_for_the_whole_batch() -> None:
    encoder = Timed(1e-6)
    prompts = await quick(encoder)
    encoder.errors = {NUMBERS[3]: TextEncoderUnavailable("nobody is there")}
    with pytest.raises(EventRefused, match="nobody is there"):
        await prompts.encode_all(NUMBERS[:4])
    assert encoder.calls == [tuple(NUMBERS[:4])]
    assert prompts.num_waiting == 0
    prompts.close()


async def test_quick_failure_does_not_make_a_slow_encoder_count_as_fast() -> None:
    encoder = Timed(TOGETHER_S)
    prompts = encoder.prompts()
    await prompts.encode("first")
    encoder.text_s, encoder.errors = 1e-6, {"second": TextEncoderUnavailable("nobody is there")}
    with pytest.raises(EventRefused, match="nobody is there"):
        await prompts.encode("second")
    encoder.text_s, encoder.errors = TOGETHER_S, {}
    await prompts.encode_all(NUMBERS[:3])
    assert encoder.calls[2:] == [(text,) for text in NUMBERS[:3]]
    prompts.close()


async def test_stored_texts_are_left_out_of_the_batch_and_the_others_stored() -> None:
    encoder = Timed(1e-6)
    store = DictStore(**{NUMBERS[1]: np.array([7], np.float32)})
    prompts = await quick(encoder, store)
    found = await prompts.encode_all(NUMBERS[:3])
    np.testing.assert_array_equal(found[NUMBERS[1]], [7])
    assert encoder.calls == [(NUMBERS[0], NUMBERS[2])]
    prompts.close()
    assert set(store.known) == {"first", *NUMBERS[:3]}
