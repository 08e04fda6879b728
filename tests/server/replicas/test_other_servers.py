"""Which servers are named to a client that finds no room: those that have lately reported some."""

from __future__ import annotations

import json
from collections import Counter
from random import Random

import pytest

from motiongen_server.engine.types import Code, Outcome, SessionKey
from motiongen_server.replicas.directory import MOST_BYTES, Replica, read_replica
from motiongen_server.replicas.hint import OtherServer, RefusedOpen
from motiongen_server.replicas.opening import open_other_servers
from motiongen_server.replicas.other_servers import OLD_S, OtherServers
from tests.server.replicas.told import Told

KEY = "0123456789abcdef"


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def replica(name: str, share: float, model: str = "m") -> Replica:
    return Replica(name, f"{name}:50051", "", {model: share})


def names(servers: OtherServers, model: str = "m") -> list[str]:
    return [each.address.partition(":")[0] for each in servers.named(model)]


def test_only_servers_with_room_for_the_model_are_named() -> None:
    told = Told(replica("free", 0.5), replica("full", 0.0), replica("nearly", 0.04), replica("other", 0.9, "n"))
    servers = OtherServers(told)
    assert servers.named("m") == ()
    servers.exchange()
    assert names(servers) == ["free"]
    assert servers.num_known == 4


def test_server_without_address_or_routing_key_is_not_named() -> None:
    servers = OtherServers(Told(Replica("nobody", "", "", {"m": 1.0}), Replica("by-key", "", KEY, {"m": 1.0})))
    servers.exchange()
    assert servers.named("m") == (OtherServer("", KEY),)


def test_at_most_three_servers_are_named_emptier_ones_more_often_first() -> None:
    told = Told(replica("a", 0.9), replica("b", 0.3), replica("c", 0.3), replica("d", 0.3))
    servers = OtherServers(told, draw=Random(1).random)
    servers.exchange()
    drawn = [names(servers) for _ in range(4000)]
    assert {len(set(each)) for each in drawn} == {3}
    first = Counter(each[0] for each in drawn)
    assert first["a"] == pytest.approx(2000, abs=200)  # 0.9 of 1.8
    assert first["b"] == pytest.approx(667, abs=150)


def test_servers_are_not_named_once_their_reports_are_old() -> None:
    clock, told = Clock(), Told(replica("free", 0.5))
    servers = OtherServers(told, clock=clock)
    servers.exchange()
    told.is_away = True
    clock.now += OLD_S - 0.1
    servers.exchange()
    assert names(servers) == ["free"]
    clock.now += 0.1
    servers.exchange()
    assert servers.named("m") == ()
    told.is_away = False
    servers.exchange()
    assert names(servers) == ["free"]


def test_server_reports_its_address_and_a_valid_routing_key_of_a_client() -> None:
    told = Told()
    servers = OtherServers(told, "here:50051")
    servers.note_call((("x-motiongen-key", "alice@example.com"), ("other", KEY)))
    servers.exchange()
    servers.note_call((("x-motiongen-key", KEY),))
    servers.exchange()
    assert [(each.address, each.routing_key, dict(each.free_shares)) for each in told.own] == [
        ("here:50051", "", {}),
        ("here:50051", KEY, {}),
    ]
    assert OtherServers(Told())._name != told.own[0].name


def test_server_reports_after_start_and_leaves_the_directory_at_close() -> None:
    told = Told()
    servers = OtherServers(told)
    servers.start(lambda: {"m": 0.25})
    servers.close()
    assert told.own[0].free_shares == {"m": 0.25}
    assert told.left == [told.own[0].name]
    assert told.is_closed


def test_close_works_while_the_store_is_away() -> None:
    told = Told()
    servers = OtherServers(told)
    servers.start(dict)
    told.is_away = True
    servers.close()
    assert told.is_closed


def test_unexpected_error_of_the_store_is_logged_once_and_tolerated(caplog: pytest.LogCaptureFixture) -> None:
    class Broken(Told):
        is_broken = True

        def exchange(self, own: Replica) -> list[Replica]:
            if self.is_broken:
                raise TypeError("an option that there is not")
            return super().exchange(own)

    told = Broken(replica("free", 0.5))
    servers = OtherServers(told)
    servers.exchange()
    servers.exchange()
    assert servers.named("m") == ()
    assert [record.message for record in caplog.records] == ["the free capacity of other servers is not known"]
    told.is_broken = False
    servers.exchange()
    assert names(servers) == ["free"]


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[]",
        b"\xff",
        b'{"address": "a:1"}',
        b'{"address": 1, "key": "", "free": {}}',
        b'{"address": "", "key": "", "free": [1]}',
        b'{"address": "", "key": "", "free": {"m": "much"}}',
        b'{"address": "", "key": "", "free": {"m": 1.5}}',
        b'{"address": "", "key": "", "free": {"m": NaN}}',
        b'{"address": "", "key": "", "free": {"m": 1%s}}' % (b"0" * 400),
        b"[" * MOST_BYTES,
        json.dumps({"address": "a" * 257, "key": "", "free": {}}).encode(),
        b'{"address": "\\ud800:1", "key": "", "free": {}}',
        b'{"address": "a:1", "key": "\\udcff", "free": {}}',
        b'{"address": "a:1\\n", "key": "", "free": {}}',
        '{"address": "", "key": "\u00fc", "free": {}}'.encode(),
        json.dumps({"address": "", "key": "", "free": {}, "more": "a" * MOST_BYTES}).encode(),
    ],
)
def test_invalid_entry_of_the_directory_is_ignored(text: bytes) -> None:
    assert read_replica("it", text) is None


def test_unknown_fields_of_a_later_version_are_ignored() -> None:
    text = b'{"address": "a:1", "key": "k", "free": {"m": 1}, "more": [1]}'
    assert read_replica("it", text) == Replica("it", "a:1", "k", {"m": 1.0})


def test_refusal_with_other_servers_keeps_all_its_fields() -> None:
    refusal = Outcome(SessionKey(3, 4), 1, Code.RESOURCE_EXHAUSTED, None, "OVERLOADED", "full", "open", "less", 2.0)
    hinted = RefusedOpen.of(refusal, (OtherServer("a:1", ""),))
    assert isinstance(hinted, RefusedOpen)
    assert Outcome(*(getattr(hinted, name) for name in Outcome.__slots__)) == refusal
    assert RefusedOpen.of(refusal, ()) is refusal


def test_only_stores_shared_between_machines_have_a_directory() -> None:
    assert open_other_servers("auto", "") is None
    assert open_other_servers("sqlite:", "a:1") is None
    several = open_other_servers("redis://localhost:1/0", "")
    assert several is not None
    several.close()
