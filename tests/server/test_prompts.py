"""The prompt encoder: what it remembers, what it shares, and what one waiter's end does to the others."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from server.prompts import PromptEncoder


class GatedEncoder:
    """Encodes a text by its length, when the test lets it."""

    identity = "gated-1"

    def __init__(self) -> None:
        self.go = threading.Event()
        self.asked: list[str] = []
        self.fails = False

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        self.asked += texts
        assert self.go.wait(10)
        if self.fails:
            raise RuntimeError("the encoder broke")
        return np.array([[len(text)] for text in texts], np.float32)


@pytest.fixture
def encoder() -> GatedEncoder:
    return GatedEncoder()


@pytest.fixture
async def prompts(encoder: GatedEncoder) -> AsyncIterator[PromptEncoder]:
    prompts = PromptEncoder(encoder, 2)
    yield prompts
    encoder.go.set()
    prompts.close()


async def test_a_text_is_encoded_once_and_remembered(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    encoder.go.set()
    assert prompts.cached("walk") is None
    first = await prompts.encode("walk")
    assert await prompts.encode("walk") is first
    assert prompts.cached("walk") is first
    assert encoder.asked == ["walk"]
    assert prompts.identity == "gated-1"


async def test_the_least_recently_used_is_forgotten(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    encoder.go.set()
    await prompts.encode("a")
    await prompts.encode("bb")
    prompts.cached("a")
    await prompts.encode("ccc")
    assert [prompts.cached(text) is not None for text in ("a", "bb", "ccc")] == [True, False, True]


async def test_who_asks_while_it_is_encoded_shares_the_result(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    waiters = [asyncio.create_task(prompts.encode("jump")) for _ in range(5)]
    await asyncio.sleep(0)  # each has asked now
    encoder.go.set()
    results = await asyncio.gather(*waiters)
    assert all(result is results[0] for result in results)
    assert encoder.asked == ["jump"]


async def test_a_waiter_that_gives_up_leaves_the_others(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    leaver, stayer = (asyncio.create_task(prompts.encode("turn")) for _ in range(2))
    await asyncio.sleep(0)  # both have asked now
    leaver.cancel()
    with pytest.raises(asyncio.CancelledError):
        await leaver
    encoder.go.set()
    np.testing.assert_array_equal(await stayer, [4])
    assert prompts.cached("turn") is not None


async def test_a_failure_reaches_the_waiters_and_is_not_remembered(
    encoder: GatedEncoder, prompts: PromptEncoder
) -> None:
    encoder.go.set()
    encoder.fails = True
    with pytest.raises(RuntimeError, match="the encoder broke"):
        await prompts.encode("fall")
    encoder.fails = False
    np.testing.assert_array_equal(await prompts.encode("fall"), [4])


async def test_each_encoding_is_observed_and_cache_hits_are_not(encoder: GatedEncoder) -> None:
    seen: list[float] = []
    prompts = PromptEncoder(encoder, 10, seen.append)
    encoder.go.set()
    for text in ("a", "b", "a"):
        await prompts.encode(text)
    prompts.close()
    assert len(seen) == 2
    assert min(seen) >= 0
