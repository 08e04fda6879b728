"""Texts of one who asks that are encoded in one call: how many, and what becomes of each."""

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
    """An encoder whose calls take so long of a clock that stands still otherwise; it fails for some texts."""

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


async def test_a_quick_encoder_takes_several_texts_of_one_who_asks_in_one_call() -> None:
    encoder = Timed(TOGETHER_S / 4)
    prompts = encoder.prompts()
    found = await prompts.encode_all([*NUMBERS[:10], *NUMBERS[:3]])
    assert list(found) == NUMBERS[:10]
    assert all(found[text] is prompts.cached(text) for text in NUMBERS[:10])
    assert [len(call) for call in encoder.calls] == [1, 4, 4, 1], "as many as take no longer than others may wait"
    encoder.text_s = 1e-6
    await prompts.encode("another")
    await prompts.encode_all(["number 3", *NUMBERS[10:]])
    assert [len(call) for call in encoder.calls[4:]] == [1, MOST_TOGETHER, 30 - MOST_TOGETHER]
    prompts.close()


async def test_a_slow_encoder_takes_one_text_at_a_time_so_that_others_have_their_turn() -> None:
    encoder = Timed(TOGETHER_S)
    prompts = encoder.prompts()
    await prompts.encode_all(NUMBERS[:5])
    assert encoder.calls == [(text,) for text in NUMBERS[:5]]
    prompts.close()


async def quick(encoder: Timed, store: DictStore | None = None) -> PromptEncoder:
    """One that takes as many texts together as may be, by now."""
    prompts = encoder.prompts(store)
    await prompts.encode("first")
    encoder.calls.clear()
    return prompts


async def test_a_text_that_cannot_be_encoded_takes_no_other_with_it() -> None:
    encoder = Timed(1e-6)
    prompts = await quick(encoder)
    encoder.errors = {NUMBERS[1]: PromptNotEncoded("not that one"), NUMBERS[2]: RuntimeError("the encoder broke")}
    asked = asyncio.create_task(prompts.encode_all(NUMBERS[:4], Asker("hostile")))
    await asyncio.sleep(0)  # it has asked now
    results = await asyncio.gather(*(prompts.encode(text) for text in NUMBERS[:4]), return_exceptions=True)
    assert encoder.calls == [tuple(NUMBERS[:4]), *((text,) for text in NUMBERS[:4])]
    assert isinstance(results[1], EventRefused)
    assert isinstance(results[2], RuntimeError)
    for number in (0, 3):
        np.testing.assert_array_equal(results[number], [len(NUMBERS[number])])
    with pytest.raises(EventRefused, match="not that one"):
        await asked
    prompts.close()


async def test_an_encoder_that_is_away_is_asked_once_for_all_of_them() -> None:
    encoder = Timed(1e-6)
    prompts = await quick(encoder)
    encoder.errors = {NUMBERS[3]: TextEncoderUnavailable("nobody is there")}
    with pytest.raises(EventRefused, match="nobody is there"):
        await prompts.encode_all(NUMBERS[:4])
    assert encoder.calls == [tuple(NUMBERS[:4])]
    assert prompts.num_waiting == 0
    prompts.close()


async def test_an_encoder_that_is_back_is_not_taken_for_quick_because_it_failed_at_once() -> None:
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


async def test_those_that_the_store_knows_are_not_asked_for_and_the_others_are_kept_there() -> None:
    encoder = Timed(1e-6)
    store = DictStore(**{NUMBERS[1]: np.array([7], np.float32)})
    prompts = await quick(encoder, store)
    found = await prompts.encode_all(NUMBERS[:3])
    np.testing.assert_array_equal(found[NUMBERS[1]], [7])
    assert encoder.calls == [(NUMBERS[0], NUMBERS[2])]
    prompts.close()
    assert set(store.known) == {"first", *NUMBERS[:3]}
