"""The C++ client and a full server: it moves to a server that is named, if none of its sessions is open yet."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from motiongen_client import MotionClient
from motiongen_server.engine.config import EngineConfig
from motiongen_server.replicas.directory import Replica
from motiongen_server.replicas.other_servers import OtherServers
from tests.client.fake_server import FakeServer
from tests.contract.local import LocalServer
from tests.cpp.test_client import character
from tests.e2e.lost_line import FACTS_AS_SERVED
from tests.server.replicas.told import Told

LIMIT_S = 120.0
KEY = "0123456789abcdef"
Program = Callable[[str], Path]


@asynccontextmanager
async def pair(named: Callable[[str], Iterable[Replica]]) -> AsyncIterator[tuple[LocalServer, LocalServer]]:
    """A server that is full with one session, and one with room. named: the servers that the first one names."""
    told = Told()
    first = LocalServer(
        facts=FACTS_AS_SERVED,
        engine_config=EngineConfig(max_sessions=1),
        other_servers=(others := OtherServers(told, clock=lambda: 0.0)),
    )
    async with asyncio.timeout(LIMIT_S), first, LocalServer(facts=FACTS_AS_SERVED) as second:
        told.others = list(named(second.address))
        await asyncio.to_thread(others.exchange)
        async with MotionClient(first.address) as taking:
            await taking.open("a person stands")
            yield first, second


def by_address(address: str) -> list[Replica]:
    return [Replica("nobody", "127.0.0.1:1", "", {"fake": 0.9}), Replica("second", address, "", {"fake": 0.9})]


async def test_refused_client_moves_to_a_named_address_that_it_was_given(program: Program) -> None:
    def play(address: str, other: str) -> None:
        with character(program, address, MOTIONGEN_OTHER=other) as walker:
            assert walker.hear("lost")[1] == "UNAVAILABLE"
            walker.hear("opened")
            walker.tell("prompt a person runs")
            assert walker.hear("edit")[2] == "OK"

    async with pair(by_address) as (first, second):
        await asyncio.to_thread(play, first.address, second.address)


@pytest.mark.parametrize("named", [by_address, lambda _: [Replica("second", "", KEY, {"fake": 0.9})], lambda _: []])
async def test_client_without_another_allowed_server_gets_the_refusal(
    program: Program, named: Callable[[str], Iterable[Replica]]
) -> None:
    """It follows no address that it was not given; with a key but no proxy, it asks the same server once more."""

    def play(address: str) -> None:
        with character(program, address) as walker:
            assert walker.hear("closed")[1] == "SESSION_LIMIT"

    async with pair(named) as (first, second):
        await asyncio.to_thread(play, first.address)
        assert second.service.num_streams == 0


def test_closed_session_that_is_refused_does_not_keep_the_next_from_moving(program: Program) -> None:
    """The server refuses the first session, which is closed by then, and the second, which may go elsewhere."""
    with FakeServer() as full, FakeServer() as other:

        def refuse(event: session_pb2.SessionEvent) -> session_pb2.EditOutcome | str:
            refused = session_pb2.EditOutcome(event_seq=1, code=8, reason="SESSION_LIMIT", message="it is full")
            refused.other_servers.add(address=other.address)
            if event.HasField("close"):
                full.stream.push(event.session, outcome=refused)
                return "SESSION_NOT_OPEN"
            if event.HasField("open"):
                return refused if event.session > 1 else session_pb2.EditOutcome()  # the first gets no answer yet
            return ""

        full.refuse = refuse
        with character(program, full.address, MOTIONGEN_OTHER=other.address) as walker:
            walker.tell("close")
            walker.tell("another")
            assert walker.hear("lost")[1] == "UNAVAILABLE"
            walker.hear("opened")
        assert [event.session for event in other.stream.received if event.HasField("open")] == [2]
