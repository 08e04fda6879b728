"""A store of embeddings that is slow or stalled: prompts are encoded without it, and no requests pile up."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray

from motiongen_ardy.text import HashedTextEncoder
from motiongen_server.text import kept
from motiongen_server.text.kept import KeptPrompts
from motiongen_server.text.prompts import PromptEncoder
from tests.waiting import LIMIT_S, try_again, until_true

ENCODER = HashedTextEncoder(4)
VECTOR = np.ones(4, np.float32)


class StalledStore:
    """Answers once the test sets `go`."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.asked: list[str] = []
        self.put_in: list[str] = []
        self.is_closed = False

    def get(self, text: str) -> NDArray[np.float32] | None:
        self.asked.append(text)
        assert self.go.wait(LIMIT_S)
        return VECTOR if text == "kept" else None

    def put(self, text: str, vector: NDArray[np.float32]) -> None:
        assert self.go.wait(LIMIT_S)
        self.put_in.append(text)

    def close(self) -> None:
        self.is_closed = True


@pytest.fixture
async def store(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[StalledStore]:
    monkeypatch.setattr(kept, "STORE_WAIT_S", 0.01)
    store = StalledStore()
    yield store
    store.go.set()


async def encoded(prompts: PromptEncoder, texts: Sequence[str]) -> None:
    for text, vector in zip(texts, await asyncio.gather(*map(prompts.encode, texts)), strict=True):
        np.testing.assert_array_equal(vector, ENCODER.encode([text])[0])


async def until_found(beside: KeptPrompts, texts: Sequence[str]) -> Mapping[str, NDArray[np.float32]]:
    while not (found := await beside.find(texts)):
        await try_again()
    return found


async def test_prompts_are_encoded_without_a_stalled_store(
    store: StalledStore, caplog: pytest.LogCaptureFixture
) -> None:
    prompts = PromptEncoder(ENCODER, 100, store=store, max_waiting=8)
    for number in range(20):
        await encoded(prompts, [f"walk {number}", f"wave {number}"])
    assert store.asked == ["walk 0"], "no prompt waits behind a request that is already late"
    assert caplog.text.count("prompt store has not answered within") == 1
    store.go.set()
    await asyncio.to_thread(prompts.close)
    assert store.asked in (["walk 0"], ["walk 0", "wave 0"])  # its thread may have taken the second before the close
    assert (store.put_in, store.is_closed) == ([], True)


async def test_requests_that_wait_for_the_store_are_bounded(
    store: StalledStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "STORE_WAIT_S", LIMIT_S)
    beside = KeptPrompts(store, 3, lambda message, value: None)
    asking = [asyncio.create_task(beside.find([str(number)])) for number in range(5)]
    await until_true(lambda: asking[4].done())
    beside.keep({"6": VECTOR})
    store.go.set()
    assert await asyncio.gather(*asking) == [{}] * 5
    await asyncio.to_thread(beside.close)
    assert (store.asked, store.put_in) == (["0", "1", "2"], [])


async def test_closing_does_not_wait_for_a_late_store(store: StalledStore, monkeypatch: pytest.MonkeyPatch) -> None:
    class Executor(ThreadPoolExecutor):
        def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
            super().shutdown(wait=False, cancel_futures=cancel_futures)
            store.go.set()  # lets the running request end
            super().shutdown(wait=wait)

    monkeypatch.setattr(kept, "ThreadPoolExecutor", Executor)
    beside = KeptPrompts(store, 3, lambda message, value: None)
    found = asyncio.create_task(beside.find(["walk"]))
    await until_true(lambda: store.asked)
    beside.keep({"wave": VECTOR})
    assert await found == {}
    await asyncio.to_thread(beside.close)
    assert (store.put_in, store.is_closed) == ([], True)


async def test_store_that_answers_again_is_read_and_written_again(
    store: StalledStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside = KeptPrompts(store, 2, lambda message, value: None)
    assert await beside.find(["kept"]) == {}
    store.go.set()
    monkeypatch.setattr(kept, "STORE_WAIT_S", LIMIT_S)
    found = await until_found(beside, ["kept", "other"])
    assert list(found) == ["kept"]
    beside.keep({"new": VECTOR})
    await asyncio.to_thread(beside.close)
    assert store.put_in == ["new"]
