"""The C++ client and servers that go away: it goes on where they send it, as far as it may."""

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


def led(program: Program, address: str, others: Sequence[str] = ()) -> AbstractContextManager[Character]:
    """One that may go to other addresses too."""
    return character(program, address, MOTIONGEN_OTHER=",".join(others))


def play(walker: Character) -> None:
    walker.tell("wait 20")
    assert walker.hear("frame")[2] == "OK"


def go_away(walker: Character, server: FakeServer, *others: Named) -> None:
    """The server names others, by addresses and keys, and ends the stream; it wishes nobody back for an hour."""
    goodbye = service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING)
    goodbye.reconnect_after.FromSeconds(3600)
    for address, key in others:
        goodbye.other_servers.add(address=address, routing_key=key)
    server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=goodbye))
    walker.hear("draining")
    server.stream.end()
    walker.hear("lost")
    walker.hear("recovered")


def test_a_server_that_goes_away_names_one_that_goes_on_with_its_sessions(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own, following, other = servers
    with led(program, own.address, [following.address, other.address]) as walker:
        play(walker)
        go_away(walker, own, ("elsewhere:1", ""), (other.address, ""))
        assert num_streams(servers) == [1, 0, 1]
        other.stream.fail(grpc.StatusCode.UNAVAILABLE)
        walker.hear("recovered")
        assert num_streams(servers) == [1, 0, 2], "it stays where it was led to"


def test_where_nobody_answers_that_was_named_it_goes_to_the_next_and_then_on_in_turn(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own, following, other = servers
    with led(program, own.address, [NOBODY, following.address, other.address]) as walker:
        play(walker)
        go_away(walker, own, (NOBODY, ""), (other.address, ""))
        assert num_streams(servers) == [1, 0, 1]
        go_away(walker, other, (NOBODY, ""))
        assert num_streams(servers) == [1, 1, 1]


def test_an_address_that_the_application_has_not_named_is_not_called(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own, following, other = servers
    with led(program, own.address, [following.address]) as walker:
        play(walker)
        go_away(walker, own, (other.address, ""))
        assert num_streams(servers) == [1, 1, 0]
    assert other.metadata == []


def test_a_server_that_goes_away_names_the_key_of_another(program: Program, servers: Sequence[FakeServer]) -> None:
    own = servers[0]
    with led(program, own.address) as walker:
        play(walker)
        go_away(walker, own, ("elsewhere:1", KEY))
        assert num_streams(servers) == [2, 0, 0]
    keys = [call["x-motiongen-key"] for call in own.metadata]
    assert keys[0] == keys[1] != KEY
    assert keys[2:] == [KEY, KEY], "of the catalogue's call and the stream's"


def test_a_character_that_a_draining_server_refuses_is_opened_by_the_next(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own = servers[0]

    def refuse(event: session_pb2.SessionEvent) -> str | session_pb2.EditOutcome:
        if not event.HasField("open") or len(own.streams) > 1:
            return ""
        outcome = session_pb2.EditOutcome(event_seq=1, code=14, reason="DRAINING", message="it goes away")
        own.stream.push(event.session, outcome=outcome)
        own.stream.end()
        return outcome  # the stream has ended: nobody hears it a second time

    own.refuse = refuse
    with led(program, own.address) as walker:
        walker.hear("opened")
        play(walker)
    assert num_streams(servers) == [2, 0, 0]


def test_connecting_asks_the_next_address_where_the_first_turns_streams_away(
    program: Program, servers: Sequence[FakeServer]
) -> None:
    own, following, _ = servers
    own.turned_away = [StreamRefused(grpc.StatusCode.UNAVAILABLE, "STARTING", "it loads").status()] * 1000
    with led(program, own.address, [following.address]) as walker:
        walker.hear("opened")
        assert num_streams(servers) == [0, 1, 0]
