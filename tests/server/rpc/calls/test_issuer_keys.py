"""Calls that wait for the keys with which their tokens are checked, each as if it were alone."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from typing import Any

import pytest

from motiongen_server.rpc.calls import issuer_keys
from motiongen_server.rpc.calls.issuer_keys import keys_for
from tests.waiting import LIMIT_S


class Callers:
    """fetch: of the keys that every token needs; None: they are known."""

    def __init__(self, fetch: Future[None] | None) -> None:
        self.fetch = fetch

    def wanted(self, metadata: object) -> Future[None] | None:
        return self.fetch


async def begun(callers: Any) -> asyncio.Task[None]:
    """A call that waits, if there is something to wait for."""
    call = asyncio.create_task(keys_for(callers, ()))
    for _ in range(3):
        await asyncio.sleep(0)
    return call


async def test_call_with_known_keys_does_not_wait() -> None:
    assert (await begun(Callers(None))).done()


async def test_call_waits_until_the_keys_are_fetched() -> None:
    fetch: Future[None] = Future()
    call = await begun(Callers(fetch))
    assert not call.done()
    fetch.set_result(None)
    async with asyncio.timeout(LIMIT_S):
        await call


async def test_cancelled_call_does_not_stop_the_fetch_for_others() -> None:
    fetch: Future[None] = Future()
    given_up, other = await begun(Callers(fetch)), await begun(Callers(fetch))
    given_up.cancel()
    with pytest.raises(asyncio.CancelledError):
        await given_up
    assert not fetch.cancelled()
    assert not other.done()
    fetch.set_result(None)
    async with asyncio.timeout(LIMIT_S):
        await other


async def test_call_stops_waiting_for_keys_after_the_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(issuer_keys, "WITHIN_S", 0.0)
    fetch: Future[None] = Future()
    async with asyncio.timeout(LIMIT_S):
        await keys_for(Callers(fetch), ())  # type: ignore[arg-type]
    assert not fetch.done()
    fetch.set_result(None)
