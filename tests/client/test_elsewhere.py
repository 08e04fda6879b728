"""Clients that a full server refuses: they go to the other servers that it names, if these are allowed."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import EventRefused, MotionClient, OtherServer
from motiongen_client.channel import ChannelSettings, Route
from tests.client.fake_server import FakeServer, full
from tests.client.waiting import received, until


async def test_refused_session_is_opened_on_the_allowed_server_that_was_named(
    server: FakeServer, other: FakeServer
) -> None:
    server.refuse = full(("elsewhere:1", ""), (other.address, ""))
    async with MotionClient(server.address, other_addresses=[other.address]) as client:
        sessions = [await client.open("walk") for _ in range(2)]
        assert [len(each.characters) for each in other.streams] == [2], "on one stream"
        server.refuse = lambda event: ""
        home = await client.open("walk")
        assert server.stream.characters, "its own server, which has room again, is asked first"
        await sessions[0].set_prompt("run")
        for session in (*sessions, home):
            await session.close()


async def test_sessions_refused_at_once_share_one_stream_to_the_other_server(
    server: FakeServer, other: FakeServer
) -> None:
    server.refuse = full((other.address, ""))
    async with MotionClient(server.address, other_addresses=lambda address: address == other.address) as client:
        await asyncio.gather(*(client.open("walk") for _ in range(8)))
        assert [len(each.characters) for each in other.streams] == [8]


async def test_server_at_an_address_that_is_not_allowed_is_not_contacted(server: FakeServer, other: FakeServer) -> None:
    server.refuse = full((other.address, ""))
    async with MotionClient(server.address) as client:
        with pytest.raises(EventRefused, match="OVERLOADED") as refused:
            await client.open("walk")
    assert refused.value.other_servers == (OtherServer(address=other.address),)
    assert (other.metadata, len(server.streams)) == ([], 1)


async def test_routing_key_that_leads_to_the_same_server_is_followed_once(server: FakeServer) -> None:
    server.refuse = full(("", "0123456789abcdef"))
    async with MotionClient(server.address) as client:
        with pytest.raises(EventRefused):
            await client.open("walk")
    assert len(server.streams) == 2
    assert server.metadata[-1]["x-motiongen-key"] == "0123456789abcdef" != server.metadata[0]["x-motiongen-key"]
    assert [len(each.received) for each in server.streams] == [1, 0], "it is not asked to open again"


async def test_routing_key_of_the_application_is_kept_when_its_server_is_full(server: FakeServer) -> None:
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


async def test_unreachable_servers_are_skipped_for_the_next_one_named(server: FakeServer, other: FakeServer) -> None:
    server.refuse = full(("127.0.0.1:1", ""), ("no address", ""), (other.address, ""))
    async with MotionClient(server.address, other_addresses=lambda _: True) as client:
        await client.open("walk")
        assert other.stream.characters


async def test_session_refused_on_reconnection_continues_on_another_server(
    server: FakeServer, other: FakeServer
) -> None:
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


async def test_session_that_no_other_server_takes_waits_for_its_own(server: FakeServer) -> None:
    async with MotionClient(server.address, other_addresses=["127.0.0.1:1"]) as client:
        session = await client.open("walk")
        server.refuse = full(("127.0.0.1:1", ""))
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)
        await until(lambda: len(server.streams) == 2 and server.stream.received)
        await until(lambda: not client._elsewhere._moving and session.is_waiting)
        server.refuse = lambda event: ""
        server.stream.fail(grpc.StatusCode.UNAVAILABLE)  # so that it asks again before the time that the server named
        await until(lambda: session.stats.reopenings == 1)
        await session.close()


async def say_goodbye(client: MotionClient, server: FakeServer, *others: tuple[str, str]) -> None:
    """Have the server name others, by address and key, ask for no reconnection within an hour, and end the stream."""
    goodbye = service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING)
    goodbye.reconnect_after.FromSeconds(3600)
    for address, key in others:
        goodbye.other_servers.add(address=address, routing_key=key)
    server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=goodbye))
    await until(lambda: client._own_stream is not None and client._own_stream.draining)
    server.stream.end()


async def test_sessions_continue_on_the_server_named_in_a_goodbye(server: FakeServer, other: FakeServer) -> None:
    async with MotionClient(server.address, other_addresses=[other.address]) as client:
        session, another = await client.open("walk"), await client.open("stand")
        await say_goodbye(client, server, ("elsewhere:1", ""), (other.address, ""))
        await until(lambda: session.stats.reopenings == another.stats.reopenings == 1)
        assert (len(other.streams), len(other.stream.characters), len(server.streams)) == (1, 2, 1)
        other.stream.fail(grpc.StatusCode.UNAVAILABLE)
        await until(lambda: session.stats.reopenings == 2)
        assert len(other.streams) == 2, "it stays with the server that was named"


async def test_unreachable_servers_of_a_goodbye_are_skipped_and_the_own_one_is_last(
    server: FakeServer, other: FakeServer
) -> None:
    async with MotionClient(server.address, other_addresses=lambda _: True) as client:
        session = await client.open("walk")
        await say_goodbye(client, server, ("127.0.0.1:1", ""), ("no address", ""), (other.address, ""))
        await until(lambda: session.stats.reopenings == 1)
        assert (len(other.streams), len(server.streams)) == (1, 1)
        await say_goodbye(client, other, ("127.0.0.1:1", ""))
        await until(lambda: session.stats.reopenings == 2)
        assert (len(other.streams), len(server.streams)) == (1, 2)


async def test_session_continues_with_the_routing_key_named_in_a_goodbye(server: FakeServer) -> None:
    async with MotionClient(server.address) as client:
        session = await client.open("walk")
        await say_goodbye(client, server, ("elsewhere:1", "0123456789abcdef"))
        await until(lambda: session.stats.reopenings == 1)
        assert server.metadata[-1]["x-motiongen-key"] == "0123456789abcdef" != server.metadata[0]["x-motiongen-key"]


def test_route_follows_allowed_addresses_only_and_keeps_the_applications_key() -> None:
    own = ChannelSettings("localhost:1", metadata=(("x-motiongen-key", "player-7"),))
    route = Route(own, lambda address: address == "localhost:2")
    assert not route.follow([OtherServer("localhost:3", "0123456789abcdef")])
    assert route._settings == own
    assert route.follow([OtherServer("localhost:2", "0123456789abcdef")])
    assert (route._settings.address, route._settings.routing_key) == ("localhost:2", "player-7")
    route.pass_over(is_starting=True)
    assert route._settings == own


def test_route_skips_names_that_are_neither_an_address_nor_a_valid_key() -> None:
    route = Route(ChannelSettings("localhost:1", metadata=(("x-motiongen-key", "0" * 16),)), lambda _: True)
    assert not route.follow([OtherServer("", "k\u00e9y"), OtherServer("", "line\nbreak")])
    assert route.follow([OtherServer("", "k\u00e9y"), OtherServer("", "0123456789abcdef")])
    assert route._settings.routing_key == "0123456789abcdef"


async def received_at(server: FakeServer, kind: str) -> list[session_pb2.SessionEvent]:
    await until(lambda: server.streams)
    return await received(server, kind)


def test_route_changes_a_random_routing_key_but_not_the_applications() -> None:
    for key, changes in (("0123456789abcdef", True), ("player-7", False)):
        route = Route(ChannelSettings("localhost:1", metadata=(("x-motiongen-key", key), ("other", "1"))))
        route.change()
        metadata = dict(route._settings.metadata)
        assert (metadata["x-motiongen-key"] != key, metadata["other"]) == (changes, "1")
