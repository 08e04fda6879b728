"""Clients that a server has no room for: they go where it sends them, as far as they may."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import EventRefused, MotionClient, OtherServer
from motiongen_client.channel import ChannelSettings, Route
from tests.client.fake_server import FakeServer, full
from tests.client.waiting import received, until


async def test_a_session_is_opened_on_the_server_that_is_named(server: FakeServer, other: FakeServer) -> None:
    server.refuse = full(("elsewhere:1", ""), (other.address, ""))
    async with MotionClient(server.address, other_addresses=[other.address]) as client:
        sessions = [await client.open("walk") for _ in range(2)]
        assert [len(each.characters) for each in other.streams] == [2], "on one stream"
        server.refuse = lambda event: ""
        home = await client.open("walk")
        assert server.stream.characters, "who has room again is asked first"
        await sessions[0].set_prompt("run")
        for session in (*sessions, home):
            await session.close()


async def test_many_that_are_refused_at_once_share_a_stream(server: FakeServer, other: FakeServer) -> None:
    server.refuse = full((other.address, ""))
    async with MotionClient(server.address, other_addresses=lambda address: address == other.address) as client:
        await asyncio.gather(*(client.open("walk") for _ in range(8)))
        assert [len(each.characters) for each in other.streams] == [8]


async def test_an_address_that_nobody_has_allowed_is_not_called(server: FakeServer, other: FakeServer) -> None:
    server.refuse = full((other.address, ""))
    async with MotionClient(server.address) as client:
        with pytest.raises(EventRefused, match="OVERLOADED") as refused:
            await client.open("walk")
    assert refused.value.other_servers == (OtherServer(address=other.address),)
    assert (other.metadata, len(server.streams)) == ([], 1)


async def test_a_key_that_leads_to_the_same_server_is_followed_once(server: FakeServer) -> None:
    server.refuse = full(("", "0123456789abcdef"))
    async with MotionClient(server.address) as client:
        with pytest.raises(EventRefused):
            await client.open("walk")
    assert len(server.streams) == 2
    assert server.metadata[-1]["x-motiongen-key"] == "0123456789abcdef" != server.metadata[0]["x-motiongen-key"]
    assert [len(each.received) for each in server.streams] == [1, 0], "it is not asked to open again"


async def test_a_key_of_the_application_is_kept_where_its_server_is_full(server: FakeServer) -> None:
    server.refuse = full(("", "0123456789abcdef"))
    async with MotionClient(server.address, metadata=[("x-motiongen-key", "player-7")]) as client:
        with pytest.raises(EventRefused):
            await client.open("walk")
    assert {each["x-motiongen-key"] for each in server.metadata} == {"player-7"}
    assert len(server.streams) == 1


async def test_servers_that_name_each_other_are_each_asked_once(server: FakeServer, other: FakeServer) -> None:
    server.refuse, other.refuse = full((other.address, "")), full((server.address, ""), (other.address, ""))
    async with MotionClient(server.address, other_addresses={server.address, other.address}) as client:
        with pytest.raises(EventRefused):
            await client.open("walk")
    assert [len(each.received) for each in (*server.streams, *other.streams)] == [1, 0, 1]


async def test_one_that_cannot_be_reached_is_passed_over(server: FakeServer, other: FakeServer) -> None:
    server.refuse = full(("127.0.0.1:1", ""), ("no address", ""), (other.address, ""))
    async with MotionClient(server.address, other_addresses=lambda _: True) as client:
        await client.open("walk")
        assert other.stream.characters


async def test_a_session_that_is_not_taken_back_goes_on_elsewhere(server: FakeServer, other: FakeServer) -> None:
    async with MotionClient(server.address, other_addresses=[other.address]) as client:
        session, stays = await client.open("walk"), await client.open("stand")
        await session.set_prompt("run")
        await until(lambda: session.playback.buffered_to > 20)
        refuse = full((other.address, ""))
        server.refuse = lambda event: refuse(event) if event.session == session.handle else ""
        handle = session.handle
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)
        (opening,) = [event.open for event in await received_at(other, "open")]
        assert [span.text for span in opening.prompts] == ["run"]
        assert opening.prior_frames.frame_count > 0
        await until(lambda: session.stats.reopenings == 1)
        assert len(server.streams) == 2
        assert (session.handle, handle) == (1, 1)
        await session.set_prompt("stop")
        assert [event.session for event in await received_at(other, "edit_prompts")] == [1]
        await until(lambda: stays.stats.reopenings == 1)
        await stays.set_prompt("run")
        await received(server, "edit_prompts")
        await session.close()
        assert not other.stream.characters
        await stays.close()


async def test_one_that_nobody_takes_waits_for_its_own_server(server: FakeServer) -> None:
    async with MotionClient(server.address, other_addresses=["127.0.0.1:1"]) as client:
        session = await client.open("walk")
        server.refuse = full(("127.0.0.1:1", ""))
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)
        await until(lambda: len(server.streams) == 2 and server.stream.received)
        await until(lambda: not client._elsewhere._moving and session.is_waiting)
        server.refuse = lambda event: ""
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)  # which has it asked before the time that the server named
        await until(lambda: session.stats.reopenings == 1)
        await session.close()


async def goes_away(client: MotionClient, server: FakeServer, *others: tuple[str, str]) -> None:
    """The server names others, by addresses and keys, and ends the stream; it wishes nobody back for an hour."""
    goodbye = service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING)
    goodbye.reconnect_after.FromSeconds(3600)
    for address, key in others:
        goodbye.other_servers.add(address=address, routing_key=key)
    server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=goodbye))
    await until(lambda: client._own_stream is not None and client._own_stream.draining)
    server.stream.end()


async def test_a_server_that_goes_away_names_one_that_goes_on_with_its_sessions(
    server: FakeServer, other: FakeServer
) -> None:
    async with MotionClient(server.address, other_addresses=[other.address]) as client:
        session, another = await client.open("walk"), await client.open("stand")
        await goes_away(client, server, ("elsewhere:1", ""), (other.address, ""))
        await until(lambda: session.stats.reopenings == another.stats.reopenings == 1)
        assert (len(other.streams), len(other.stream.characters), len(server.streams)) == (1, 2, 1)
        other.stream.fail(grpc.StatusCode.UNAVAILABLE)
        await until(lambda: session.stats.reopenings == 2)
        assert len(other.streams) == 2, "it stays where it was led to"


async def test_where_nobody_answers_that_was_named_it_goes_to_the_next_and_then_back(
    server: FakeServer, other: FakeServer
) -> None:
    async with MotionClient(server.address, other_addresses=lambda _: True) as client:
        session = await client.open("walk")
        await goes_away(client, server, ("127.0.0.1:1", ""), ("no address", ""), (other.address, ""))
        await until(lambda: session.stats.reopenings == 1)
        assert (len(other.streams), len(server.streams)) == (1, 1)
        await goes_away(client, other, ("127.0.0.1:1", ""))
        await until(lambda: session.stats.reopenings == 2)
        assert (len(other.streams), len(server.streams)) == (1, 2)


async def test_a_server_that_goes_away_names_the_key_of_another(server: FakeServer) -> None:
    async with MotionClient(server.address) as client:
        session = await client.open("walk")
        await goes_away(client, server, ("elsewhere:1", "0123456789abcdef"))
        await until(lambda: session.stats.reopenings == 1)
        assert server.metadata[-1]["x-motiongen-key"] == "0123456789abcdef" != server.metadata[0]["x-motiongen-key"]


def test_a_route_keeps_the_key_of_an_application_and_addresses_that_nobody_has_allowed_out() -> None:
    own = ChannelSettings("localhost:1", metadata=(("x-motiongen-key", "player-7"),))
    route = Route(own, lambda address: address == "localhost:2")
    assert not route.follow([OtherServer("localhost:3", "0123456789abcdef")])
    assert route._settings == own
    assert route.follow([OtherServer("localhost:2", "0123456789abcdef")])
    assert (route._settings.address, route._settings.routing_key) == ("localhost:2", "player-7")
    route.pass_over(is_starting=True)
    assert route._settings == own


def test_a_route_passes_over_a_name_that_is_neither_an_address_nor_a_key() -> None:
    route = Route(ChannelSettings("localhost:1", metadata=(("x-motiongen-key", "0" * 16),)), lambda _: True)
    assert not route.follow([OtherServer("", "k\u00e9y"), OtherServer("", "line\nbreak")])
    assert route.follow([OtherServer("", "k\u00e9y"), OtherServer("", "0123456789abcdef")])
    assert route._settings.routing_key == "0123456789abcdef"


async def received_at(server: FakeServer, kind: str) -> list[session_pb2.SessionEvent]:
    await until(lambda: server.streams)
    return await received(server, kind)


def test_a_route_changes_the_key_that_was_drawn_and_no_other() -> None:
    for key, changes in (("0123456789abcdef", True), ("player-7", False)):
        route = Route(ChannelSettings("localhost:1", metadata=(("x-motiongen-key", key), ("other", "1"))))
        route.change()
        metadata = dict(route._settings.metadata)
        assert (metadata["x-motiongen-key"] != key, metadata["other"]) == (changes, "1")
