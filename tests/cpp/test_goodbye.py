"""The C++ client and draining servers: it continues on the servers that they name, if these are allowed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.errors import StreamRefused
from tests.client.fake_server import FakeServer
from tests.cpp.test_client import Character, character

Program = Callable[[str], Path]
Named = tuple[str, str]
KEY = "0123456789abcdef"
NOBODY = "127.0.0.1:1"


@pytest.fixture
def servers() -> Iterator[Sequence[FakeServer]]:
    with FakeServer(replica_id="own") as own, FakeServer(replica_id="next") as following, FakeServer() as other:
        yield own, following, other


def num_streams(servers: Sequence[FakeServer]) -> list[int]:
    return [len(each.streams) for each in servers]


def character_with_others(
    program: Program, address: str, others: Sequence[str] = ()
) -> AbstractContextManager[Character]:
    """A character that may connect to other addresses too."""
    return character(program, address, MOTIONGEN_OTHER=",".join(others))


def play(walker: Character) -> None:
    walker.tell("wait 20")
    assert walker.hear("frame")[2] == "OK"


def say_goodbye(walker: Character, server: FakeServer, *others: Named) -> None:
    """Have the server name others, by address and key, ask for no reconnection within an hour, and end the stream."""
    goodbye = service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING)
    goodbye.reconnect_after.FromSeconds(3600)
    for address, key in others:
        goodbye.other_servers.add(address=address, routing_key=key)
    server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=goodbye))
    walker.hear("draining")
    server.stream.end()
    walker.hear("lost")
    walker.hear("recovered")


def test_session_continues_on_the_server_named_in_a_goodbye(program: Program, servers: Sequence[FakeServer]) -> None:
    own, following, other = servers
    with character_with_others(program, own.address, [following.address, other.address]) as walker:
        play(walker)
        say_goodbye(walker, own, ("elsewhere:1", ""), (other.address, ""))
        assert num_streams(servers) == [1, 0, 1]
        other.stream.fail(grpc.StatusCode.UNAVAILABLE)
        walker.hear("recovered")
        assert num_streams(servers) == [1, 0, 2], "it stays with the server that was named"


def test_unreachable_servers_of_a_goodbye_are_skipped_then_own_addresses_tried(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own, following, other = servers
    with character_with_others(program, own.address, [NOBODY, following.address, other.address]) as walker:
        play(walker)
        say_goodbye(walker, own, (NOBODY, ""), (other.address, ""))
        assert num_streams(servers) == [1, 0, 1]
        say_goodbye(walker, other, (NOBODY, ""))
        assert num_streams(servers) == [1, 1, 1]


def test_server_at_an_address_the_application_did_not_name_is_not_contacted(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own, following, other = servers
    with character_with_others(program, own.address, [following.address]) as walker:
        play(walker)
        say_goodbye(walker, own, (other.address, ""))
        assert num_streams(servers) == [1, 1, 0]
    assert other.metadata == []


def test_session_continues_with_the_routing_key_named_in_a_goodbye(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own = servers[0]
    with character_with_others(program, own.address) as walker:
        play(walker)
        say_goodbye(walker, own, ("elsewhere:1", KEY))
        assert num_streams(servers) == [2, 0, 0]
    keys = [call["x-motiongen-key"] for call in own.metadata]
    assert keys[0] == keys[1] != KEY
    assert keys[2:] == [KEY, KEY], "the catalogue's call and the stream's"


def test_session_refused_by_a_draining_server_is_opened_on_reconnection(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own = servers[0]

    def refuse(event: session_pb2.SessionEvent) -> str | session_pb2.EditOutcome:
        if not event.HasField("open") or len(own.streams) > 1:
            return ""
        outcome = session_pb2.EditOutcome(event_seq=1, code=14, reason="DRAINING", message="it goes away")
        own.stream.push(event.session, outcome=outcome)
        own.stream.end()
        return outcome  # the stream has ended, so this one is not sent

    own.refuse = refuse
    with character_with_others(program, own.address) as walker:
        walker.hear("opened")
        play(walker)
    assert num_streams(servers) == [2, 0, 0]


def test_connecting_tries_the_next_address_when_the_first_refuses_streams(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own, following, _ = servers
    own.turned_away = [StreamRefused(grpc.StatusCode.UNAVAILABLE, "STARTING", "it loads").status()] * 1000
    with character_with_others(program, own.address, [following.address]) as walker:
        walker.hear("opened")
        assert num_streams(servers) == [0, 1, 0]
