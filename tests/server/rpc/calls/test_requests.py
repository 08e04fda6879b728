"""Waiting for the one request of a call: for how long, for how many calls at once, and what is no valid request."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import grpc.aio
import pytest

from motiongen.v1 import service_pb2
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.calls import requests as requests_module
from motiongen_server.rpc.calls.requests import SMALL_REQUEST_BYTES, AwaitedRequest, Requests, parsed_as
from tests.waiting import LIMIT_S, until_true

ENDLESS_S = 1e6
END = grpc.aio.EOF


class Client:
    """A call whose client sends these, and then nothing."""

    def __init__(self, *sends: Any, peer: str = "ipv4:10.0.0.7:1") -> None:
        self._sends = list(sends)
        self._peer = peer

    def peer(self) -> str:
        return self._peer

    async def read(self) -> Any:
        if not self._sends:
            await asyncio.Event().wait()
        return self._sends.pop(0)


async def reason_of(requests: Requests, client: Client) -> str:
    with pytest.raises(StreamRefused) as refused:
        await requests.only(client)  # type: ignore[arg-type]
    return refused.value.reason


async def test_one_request_and_a_half_close_are_accepted() -> None:
    requests = Requests(ENDLESS_S)
    assert await requests.only(Client(b"asked", END)) == b"asked"  # type: ignore[arg-type]
    assert await requests.only(Client(b"", END)) == b""  # type: ignore[arg-type]


@pytest.mark.parametrize("sends", [(), (b"asked",)], ids=["nothing", "no end"])
async def test_call_without_a_complete_request_is_ended_after_the_limit(sends: tuple[bytes, ...]) -> None:
    async with asyncio.timeout(LIMIT_S):
        assert await reason_of(Requests(0.01), Client(*sends)) == "REQUEST_LATE"


@pytest.mark.parametrize("sends", [(END,), (b"", b""), (b"a", b"b", END)], ids=["none", "two", "two and the end"])
async def test_none_or_more_than_one_request_is_refused(sends: tuple[Any, ...]) -> None:
    assert await reason_of(Requests(ENDLESS_S), Client(*sends)) == "ONE_REQUEST_EXPECTED"


async def test_request_that_is_too_long_is_refused_at_once() -> None:
    requests, most = Requests(ENDLESS_S), SMALL_REQUEST_BYTES
    async with asyncio.timeout(LIMIT_S):
        assert await reason_of(requests, Client(b"a" * (most + 1))) == "REQUEST_TOO_LONG", "no half-close is needed"
    longest = b"a" * most
    assert await requests.only(Client(longest, END)) == longest  # type: ignore[arg-type]
    assert await requests.only(Client(longest + b"a", END), None) == longest + b"a"  # type: ignore[arg-type]


async def test_bytes_of_a_request_are_counted_from_its_message_to_its_end() -> None:
    counted: list[AwaitedRequest] = []

    @contextmanager
    def arrive(request: AwaitedRequest) -> Iterator[None]:
        counted.append(request)
        try:
            yield
        finally:
            counted.remove(request)

    client = Client(b"asked")
    asking = asyncio.create_task(Requests(ENDLESS_S).only(client, None, arrive))  # type: ignore[arg-type]
    async with asyncio.timeout(LIMIT_S):
        await until_true(lambda: counted)
        (request,) = counted
        assert request.num_waiting_bytes == len(b"asked")
        request.fail(RuntimeError("a fault"))
        with pytest.raises(StreamRefused) as refused:
            await asking
    assert refused.value.reason == "INTERNAL"
    assert request.num_waiting_bytes == 0
    assert await Requests(ENDLESS_S).only(Client(b"asked", END), None, arrive) == b"asked"  # type: ignore[arg-type]
    assert counted == []


@pytest.mark.parametrize(
    ("most", "most_of_an_address", "goes"),
    [(100, 2, "second"), (3, 100, "first")],
    ids=["of the address", "of all"],
)
async def test_longest_waiting_call_is_ended_where_too_many_wait(
    most: int, most_of_an_address: int, goes: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests_module, "MOST_WAITING", most)
    monkeypatch.setattr(requests_module, "MOST_WAITING_OF_AN_ADDRESS", most_of_an_address)
    requests = Requests(ENDLESS_S)
    waiting: dict[str, asyncio.Task[bytes]] = {}
    for name, address in (("first", "10.0.0.8"), ("second", "10.0.0.7"), ("third", "10.0.0.7"), ("last", "10.0.0.7")):
        client = Client(peer=f"ipv4:{address}:1")
        waiting[name] = asyncio.create_task(requests.only(client))  # type: ignore[arg-type]
    async with asyncio.timeout(LIMIT_S):
        await until_true(waiting[goes].done)
        assert [name for name, task in waiting.items() if task.done()] == [goes]
        assert await requests.only(Client(b"asked", END)) == b"asked"  # type: ignore[arg-type]
    for task in waiting.values():
        task.cancel()
    ends = await asyncio.gather(*waiting.values(), return_exceptions=True)
    assert [end.reason for end in ends if isinstance(end, StreamRefused)] == ["REQUEST_LATE"] * 2
    assert requests._of_address == {}
    assert not requests._all


def test_bytes_that_are_no_message_are_refused() -> None:
    with pytest.raises(StreamRefused, match="could not be read") as refused:
        parsed_as(service_pb2.GetCatalogRequest, b"\xff")
    assert refused.value.reason == "MALFORMED_REQUEST"
    assert parsed_as(service_pb2.GetCatalogRequest, b"") == service_pb2.GetCatalogRequest()
