"""The prompt encoder: its cache, shared encodings, limits, and waiters that give up."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from motiongen_ardy.text.encoder import PromptNotEncoded, TextEncoderUnavailable
from motiongen_server.engine.types import Code
from motiongen_server.errors import EventRefused
from motiongen_server.text.prompts import ENCODING_THREADS, PromptEncoder
from motiongen_server.text.turns import Asker
from tests.waiting import LIMIT_S


class GatedEncoder:
    """Encodes a text as its length, once the test sets `go`."""

    identity = "gated-1"

    def __init__(self) -> None:
        self.go = threading.Event()
        self.begun = threading.Event()
        self.asked: list[str] = []
        self.fails = False
        self.error: Exception | None = None

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        self.asked += texts
        self.begun.set()
        assert self.go.wait(LIMIT_S)
        if self.error is not None:
            raise self.error
        if self.fails:
            raise RuntimeError("the encoder broke")
        return np.array([[len(text)] for text in texts], np.float32)


async def settled() -> None:
    """Wait until all tasks that were begun are queued."""
    for _ in range(5):
        await asyncio.sleep(0)


@pytest.fixture
def encoder() -> GatedEncoder:
    return GatedEncoder()


@pytest.fixture
async def prompts(encoder: GatedEncoder) -> AsyncIterator[PromptEncoder]:
    prompts = PromptEncoder(encoder, 2)
    yield prompts
    encoder.go.set()
    prompts.close()


async def test_text_is_encoded_once_and_cached(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    encoder.go.set()
    assert prompts.cached("walk") is None
    first = await prompts.encode("walk")
    assert await prompts.encode("walk") is first
    assert prompts.cached("walk") is first
    assert encoder.asked == ["walk"]
    assert prompts.identity == "gated-1"


async def test_least_recently_used_text_leaves_the_cache(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    encoder.go.set()
    await prompts.encode("a")
    await prompts.encode("bb")
    prompts.cached("a")
    await prompts.encode("ccc")
    assert [prompts.cached(text) is not None for text in ("a", "bb", "ccc")] == [True, False, True]


async def test_requests_during_an_encoding_share_its_result(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    waiters = [asyncio.create_task(prompts.encode("jump")) for _ in range(5)]
    await asyncio.sleep(0)  # each task is waiting now
    encoder.go.set()
    results = await asyncio.gather(*waiters)
    assert all(result is results[0] for result in results)
    assert encoder.asked == ["jump"]


async def test_batch_with_a_text_already_under_way_waits_for_that_one(encoder: GatedEncoder) -> None:
    prompts = PromptEncoder(encoder, 10)
    first = asyncio.create_task(prompts.encode("bb"))
    await asyncio.sleep(0)  # it is waiting now
    both = asyncio.create_task(prompts.encode_all(["a", "bb"]))
    encoder.go.set()
    assert (await both)["bb"] is await first
    assert sorted(encoder.asked) == ["a", "bb"]
    prompts.close()


async def test_waiter_that_gives_up_does_not_cancel_the_others(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    leaver, stayer = (asyncio.create_task(prompts.encode("turn")) for _ in range(2))
    await asyncio.sleep(0)  # both are waiting now
    leaver.cancel()
    with pytest.raises(asyncio.CancelledError):
        await leaver
    encoder.go.set()
    np.testing.assert_array_equal(await stayer, [4])
    assert prompts.cached("turn") is not None


async def test_failure_reaches_all_waiters_and_is_not_cached(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    encoder.go.set()
    encoder.fails = True
    with pytest.raises(RuntimeError, match="the encoder broke"):
        await prompts.encode("fall")
    encoder.fails = False
    np.testing.assert_array_equal(await prompts.encode("fall"), [4])


async def test_encodings_are_observed_and_cache_hits_are_not(encoder: GatedEncoder) -> None:
    seen: list[float] = []
    prompts = PromptEncoder(encoder, 10, observe=seen.append)
    encoder.go.set()
    for text in ("a", "b", "a"):
        await prompts.encode(text)
    prompts.close()
    assert len(seen) == 2
    assert min(seen) >= 0


class DictStore:
    """A store in memory."""

    def __init__(self, **known: NDArray[np.float32]) -> None:
        self.known = dict(known)
        self.closed = False

    def get(self, text: str) -> NDArray[np.float32] | None:
        return self.known.get(text)

    def put(self, text: str, vector: NDArray[np.float32]) -> None:
        self.known[text] = vector

    def close(self) -> None:
        self.closed = True


async def test_stored_text_does_not_wait_for_the_encoder(encoder: GatedEncoder) -> None:
    store = DictStore(walk=np.array([7], np.float32))
    prompts = PromptEncoder(encoder, 10, store=store)
    hanging = [asyncio.create_task(prompts.encode(f"new {number}")) for number in range(2 * ENCODING_THREADS)]
    np.testing.assert_array_equal(await prompts.encode("walk"), [7])
    assert prompts.num_waiting == len(hanging)
    assert "walk" not in encoder.asked
    encoder.go.set()
    await asyncio.gather(*hanging)
    prompts.close()
    assert store.closed
    assert set(store.known) == {"walk", *(f"new {number}" for number in range(2 * ENCODING_THREADS))}


async def test_late_encoding_is_refused_and_its_result_serves_the_next_request(encoder: GatedEncoder) -> None:
    prompts = PromptEncoder(encoder, 10, timeout_s=0.01)
    with pytest.raises(EventRefused) as refused:
        await prompts.encode("crawl")
    assert (refused.value.code, refused.value.reason) == (Code.UNAVAILABLE, "TEXT_ENCODER_SLOW")
    assert refused.value.retry_after_s
    encoder.go.set()
    await asyncio.gather(
        *asyncio.all_tasks() - {asyncio.current_task()}
    )  # the encoding, for which no request waits any more
    np.testing.assert_array_equal(await prompts.encode("crawl"), [5])
    assert encoder.asked == ["crawl"]
    prompts.close()


async def test_requests_beyond_the_limit_are_refused_at_once(encoder: GatedEncoder) -> None:
    reasons: list[str] = []
    prompts = PromptEncoder(encoder, 10, max_waiting=2, count=reasons.append)
    waiting = [asyncio.create_task(prompts.encode(text)) for text in ("a", "bb")]
    await asyncio.sleep(0)  # both are waiting now
    with pytest.raises(EventRefused) as refused:
        await prompts.encode("ccc")
    assert (refused.value.code, refused.value.reason) == (Code.RESOURCE_EXHAUSTED, "TEXT_ENCODER_BUSY")
    joined = asyncio.create_task(prompts.encode("a"))  # joins a text that is already under way
    encoder.go.set()
    await asyncio.gather(*waiting, joined)
    prompts.close()
    assert sorted(reasons) == ["TEXT_ENCODER_BUSY", "encoder", "encoder"]


async def test_peer_with_many_streams_neither_fills_the_queue_nor_delays_others(
    encoder: GatedEncoder,
) -> None:
    prompts = PromptEncoder(encoder, 100, max_waiting=20)
    hostile = [asyncio.create_task(prompts.encode(f"new {n}", Asker("hostile", n))) for n in range(40)]
    await settled()
    good = [asyncio.create_task(prompts.encode(f"good {n}", Asker("good", n))) for n in range(2)]
    await settled()
    encoder.go.set()
    results = await asyncio.gather(*hostile, *good, return_exceptions=True)
    prompts.close()
    refused = [result.reason for result in results if isinstance(result, EventRefused)]
    assert refused == ["TEXT_ENCODER_BUSY"] * 22
    assert not any(isinstance(result, Exception) for result in results[40:])
    places = sorted(encoder.asked.index(text) for text in ("good 0", "good 1"))
    assert places[1] < 2 * ENCODING_THREADS + 4, "after those under way, then about every second turn"


async def test_text_queued_by_another_peer_is_served_in_the_newcomers_turn(encoder: GatedEncoder) -> None:
    prompts = PromptEncoder(encoder, 100, max_waiting=20)
    hostile = [asyncio.create_task(prompts.encode(f"new {n}", Asker("hostile", n))) for n in range(20)]
    await settled()
    joined = asyncio.create_task(prompts.encode("new 19", Asker("good")))
    await settled()
    others = [asyncio.create_task(prompts.encode(f"other {n}", Asker("other", n))) for n in range(4)]
    await settled()
    encoder.go.set()
    np.testing.assert_array_equal(await joined, [6])
    await asyncio.gather(*hostile, *others, return_exceptions=True)
    prompts.close()
    assert encoder.asked.index("new 19") < 2 * ENCODING_THREADS + 4, (
        "in the turn of the first peer alone it would be the last of 20"
    )


async def test_stored_text_is_answered_while_the_queue_is_full(encoder: GatedEncoder) -> None:
    prompts = PromptEncoder(encoder, 10, store=DictStore(walk=np.array([7], np.float32)), max_waiting=2)
    hanging = [asyncio.create_task(prompts.encode(text)) for text in ("a", "bb")]
    await asyncio.to_thread(encoder.begun.wait)
    np.testing.assert_array_equal(await prompts.encode("walk"), [7])
    with pytest.raises(EventRefused, match="wait for the text encoder already"):
        await prompts.encode("ccc")
    encoder.go.set()
    await asyncio.gather(*hanging)
    prompts.close()


async def test_unavailable_encoder_is_refused_and_cached_prompts_still_answered(
    encoder: GatedEncoder, caplog: pytest.LogCaptureFixture
) -> None:
    encoder.go.set()
    prompts = PromptEncoder(encoder, 10)
    known = await prompts.encode("walk")
    encoder.error = TextEncoderUnavailable("nobody is there")
    for text in ("a", "bb", "ccc"):
        with pytest.raises(EventRefused, match="cannot be encoded: nobody is there") as refused:
            await prompts.encode(text)
        assert (refused.value.code, refused.value.reason) == (Code.UNAVAILABLE, "TEXT_ENCODER_UNAVAILABLE")
        assert refused.value.retry_after_s == TextEncoderUnavailable.retry_after_s
    assert await prompts.encode("walk") is known
    assert caplog.text.count("nobody is there") == 1  # logged once, not once for each prompt
    encoder.error = None
    np.testing.assert_array_equal(await prompts.encode("a"), [1])
    prompts.close()


async def test_prompt_that_can_never_be_encoded_gets_no_time_to_retry(encoder: GatedEncoder) -> None:
    encoder.go.set()
    encoder.error = PromptNotEncoded("none of those known")
    prompts = PromptEncoder(encoder, 10)
    with pytest.raises(EventRefused, match="none of those known") as refused:
        await prompts.encode("a")
    assert refused.value.retry_after_s is None
    prompts.close()


async def test_remembered_text_is_not_encoded(encoder: GatedEncoder, prompts: PromptEncoder) -> None:
    preset = np.array([9], np.float32)
    prompts.remember("bow", preset)
    assert await prompts.encode("bow") is preset
    assert encoder.asked == []


async def test_closing_interrupts_calls_to_a_remote_encoder() -> None:
    class Elsewhere(GatedEncoder):
        def close(self) -> None:
            self.error = TextEncoderUnavailable("closed")
            self.go.set()

    encoder = Elsewhere()
    prompts = PromptEncoder(encoder, 10)
    asked = asyncio.create_task(prompts.encode("walk"))
    await asyncio.to_thread(encoder.begun.wait)
    await asyncio.to_thread(prompts.close)
    with pytest.raises(EventRefused, match="closed"):
        await asked
