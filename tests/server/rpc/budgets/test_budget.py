"""Budgets of streams and peers: a stream that sends too much is read more slowly, and its address pays as well."""

from __future__ import annotations

import pytest

from motiongen_server.engine.types import Owner, Priority
from motiongen_server.errors import EventRefused
from motiongen_server.identity.caller import Caller
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.peers import MOST_IDLE, Peers, address_of
from motiongen_server.rpc.budgets.stream_budget import BYTES_A_TOKEN, MESSAGE_COST, StreamBudget
from motiongen_server.rpc.limits import PeerLimits


def peer_of(**limits: float) -> Peer:
    return Peer(PeerLimits(**limits), 0.0)  # type: ignore[arg-type]


def test_burst_is_free_and_anything_beyond_it_is_owed() -> None:
    budget = StreamBudget(100.0, peer_of(), 0.0)
    budget.charge(100.0, 0.0)
    assert budget.owed_s(0.0) == 0
    budget.charge(50.0, 0.0)
    assert budget.owed_s(0.0) == pytest.approx(0.5)
    assert budget.owed_s(0.25) == pytest.approx(0.25)
    assert budget.owed_s(0.5) == 0


def test_bytes_of_a_message_are_charged() -> None:
    budget = StreamBudget(MESSAGE_COST + 10, peer_of(), 0.0)
    budget.charge_message(int(20 * BYTES_A_TOKEN), 0.0)
    assert budget.owed_s(0.0) * (MESSAGE_COST + 10) == pytest.approx(10)


def test_bytes_are_charged_to_a_budget_of_the_peer_too() -> None:
    peer = peer_of(bytes_per_second=1000.0)
    peer.num_streams = 1
    budget = StreamBudget(1e9, peer, 0.0)
    budget.charge_message(1500, 0.0)
    assert budget.owed_s(0.0) == pytest.approx(0.5)
    assert peer.bytes.owed_s(0.0) == pytest.approx(0.5)


def test_streams_of_a_peer_share_its_budget_and_other_peers_do_not() -> None:
    peer = peer_of(events_per_second=100.0)
    peer.num_streams = 2
    first, second = StreamBudget(1000.0, peer, 0.0), StreamBudget(1000.0, peer, 0.0)
    elsewhere = StreamBudget(1000.0, peer_of(events_per_second=100.0), 0.0)
    first.charge(200.0, 0.0)
    assert first.owed_s(0.0) == pytest.approx(1.0)
    second.charge(60.0, 0.0)
    assert second.owed_s(0.0) == pytest.approx(0.2), "it is in debt for more than half of what both may have"
    assert elsewhere.owed_s(0.0) == 0


def test_stream_within_its_equal_part_never_waits_for_others_of_its_peer() -> None:
    peer = peer_of(events_per_second=100.0)
    peer.num_streams = 2
    greedy, modest = StreamBudget(1e6, peer, 0.0), StreamBudget(1e6, peer, 0.0)
    greedy.charge(10_000.0, 0.0)
    for tenth in range(100):
        modest.charge(4.0, tenth / 10)
        assert modest.owed_s(tenth / 10) == 0
    assert greedy.owed_s(10.0) > 10


def test_heroes_of_a_peer_are_limited_and_released_places_are_free() -> None:
    peer = peer_of(heroes=2)
    places = [peer.place(Priority.HERO, 0.0) for _ in range(2)]
    with pytest.raises(EventRefused) as refused:
        peer.place(Priority.HERO, 0.0)
    assert (refused.value.reason, refused.value.field) == ("PEER_SESSION_LIMIT", "open.priority")
    peer.place(Priority.NEAR, 0.0)
    places[0].release()
    places[0].release()
    peer.place(Priority.HERO, 0.0)
    with pytest.raises(EventRefused):
        peer.place(Priority.HERO, 0.0)


def test_sessions_are_weighted_by_their_class() -> None:
    peer = peer_of(session_weight=7)
    held = [peer.place(priority, 0.0) for priority in (Priority.HERO, Priority.NEAR, Priority.CROWD)]
    with pytest.raises(EventRefused, match="as many sessions"):
        peer.place(Priority.BATCH, 0.0)
    held[1].release()
    peer.place(Priority.CROWD, 0.0)
    peer.place(Priority.BATCH, 0.0)
    assert peer.session_weight == 7


def test_steps_of_a_peer_s_sessions_stay_within_its_quota() -> None:
    peer = peer_of(steps_per_second=10.0)
    places = [peer.place(Priority.CROWD, 0.0) for _ in range(3)]
    for place in places[:2]:
        place.begin_steps(4.0)
    with pytest.raises(EventRefused, match="need 12 denoising steps") as refused:
        places[2].begin_steps(4.0)
    assert (refused.value.reason, refused.value.field) == ("STEPS_QUOTA", "open.denoise_steps")
    places[0].release()
    places[0].release()
    places[2].begin_steps(4.0)
    with pytest.raises(EventRefused):
        peer.place(Priority.CROWD, 0.0).begin_steps(4.0)


def test_owner_of_a_peer_has_its_name_share_and_quota() -> None:
    peers = Peers(PeerLimits(share=2.5, steps_per_second=40.0))
    one, other = peers.find("ipv4:10.0.0.7:5", 0.0), peers.find("ipv4:10.0.0.8:5", 0.0)
    assert one.owner == Owner("ipv4:10.0.0.7", 2.5, 40.0)
    assert other.owner.name != one.owner.name


def test_engines_are_told_of_new_tenants_and_of_changed_shares_or_quotas() -> None:
    told: list[Owner] = []
    peers = Peers(PeerLimits(), note_owner=told.append)
    address = peers.find("ipv4:10.0.0.7:5", 0.0)
    assert told == []
    quota = {"share": 2.0, "events_per_second": 10.0}
    tenant = peers.of(Caller("studio", quota=quota), address, 0.0)
    assert told == [Owner("tenant:studio", 2.0)]
    peers.renew({"studio": {"share": 2.0, "events_per_second": 20.0}, "other": {}}, 0.0)
    assert (tenant.limits.events_per_second, len(told)) == (20.0, 1)
    peers.renew({"studio": {"share": 2.0, "steps_per_second": 50.0}}, 0.0)
    assert told[1:] == [Owner("tenant:studio", 2.0, 50.0)]
    assert tenant.limits.events_per_second == PeerLimits().events_per_second
    for number in range(MOST_IDLE):
        peers.find(f"ipv4:9.{number >> 8}.{number & 255}.1:1", 1.0)
    again = peers.of(Caller("studio", quota=quota), address, 2.0)
    assert again is not tenant
    assert told[2:] == [Owner("tenant:studio", 2.0)], "engines may remember what it had before it was forgotten"


def test_samples_of_clips_count_while_they_are_made() -> None:
    peer = peer_of(clip_samples=4)
    peer.begin_clip(3)
    with pytest.raises(EventRefused) as refused:
        peer.begin_clip(2)
    assert refused.value.reason == "PEER_CLIP_LIMIT"
    peer.end_clip(3)
    peer.begin_clip(4)


def test_name_of_a_peer_is_its_address_without_the_port() -> None:
    assert address_of("ipv4:10.0.0.7:1234") == address_of("ipv4:10.0.0.7:4321") == "ipv4:10.0.0.7"
    assert address_of("unix:") == address_of("unix:/run/x") == "unix"


def test_ipv6_addresses_of_a_network_share_one_budget() -> None:
    peers = Peers(PeerLimits(heroes=1))
    one, other = (peers.find(f"ipv6:%5B2001:db8::{host}%5D:55000", 0.0) for host in (7, 8))
    assert one is other
    assert one.name == "ipv6:2001:db8::/64"
    elsewhere = peers.find("ipv6:%5B2001:db8:0:1::7%5D:55000", 0.0)
    link_local = peers.find("ipv6:%5Bfe80::7%25eth0%5D:55000", 0.0)
    assert len({one, elsewhere, link_local}) == 3


def test_an_ipv4_address_has_the_same_budget_however_it_is_written() -> None:
    assert address_of("ipv6:%5B::ffff:10.0.0.7%5D:55000") == address_of("ipv4:10.0.0.7:1") == "ipv4:10.0.0.7"


def test_only_peers_without_debt_or_sessions_are_forgotten() -> None:
    peers = Peers(PeerLimits(events_per_second=10.0))
    debtor = peers.find("ipv4:1.1.1.1:1", 0.0)
    debtor.events.charge(1000.0, 0.0)
    holder = peers.find("ipv4:2.2.2.2:1", 0.0)
    holder.place(Priority.NEAR, 0.0)
    quiet = peers.find("ipv4:3.3.3.3:1", 0.0)
    for number in range(MOST_IDLE):
        peers.find(f"ipv4:9.{number >> 8}.{number & 255}.1:1", 0.0)
    assert peers.find("ipv4:1.1.1.1:2", 1.0) is debtor
    assert peers.find("ipv4:2.2.2.2:2", 1.0) is holder
    assert peers.find("ipv4:3.3.3.3:2", 1.0) is not quiet


def test_many_new_addresses_are_not_all_visited_for_each_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    visits, is_idle = 0, Peer.is_idle

    def counted(peer: Peer, now: float) -> bool:
        nonlocal visits
        visits += 1
        return is_idle(peer, now)

    monkeypatch.setattr(Peer, "is_idle", counted)
    peers, num_addresses = Peers(), 2 * MOST_IDLE
    for number in range(num_addresses):
        peers.find(f"ipv4:9.{number >> 8}.{number & 255}.1:1", 0.0).begin_stream()
    assert visits <= num_addresses
    quiet = peers.find("ipv4:1.1.1.1:1", 0.0)
    peers.find("ipv4:2.2.2.2:1", 1.0)
    assert peers.find("ipv4:1.1.1.1:1", 1.0) is not quiet, "a peer with nothing open is forgotten nevertheless"


@pytest.mark.parametrize(("priority", "quota"), [(Priority.NEAR, "nears"), (Priority.CROWD, "crowds"),
                                                 (Priority.BATCH, "batches")])  # fmt: skip
def test_refusal_names_the_quota_of_the_class(priority: Priority, quota: str) -> None:
    peer = peer_of(**{quota: 1})
    peer.place(priority, 0.0)
    with pytest.raises(EventRefused, match=rf"1 sessions of the class {priority.name}, its quota \({quota}\)"):
        peer.place(priority, 0.0)
    peer.place(Priority.HERO, 0.0)


def test_opening_streams_again_and_again_does_not_increase_the_budget() -> None:
    peer = peer_of(events_per_second=100.0, bytes_per_second=1e9)
    peer.num_streams, sent = 1, 0.0
    for tenth in range(100):
        stream = StreamBudget(1e6, peer, tenth / 10)  # the one before has ended
        while stream.owed_s(tenth / 10) == 0:
            stream.charge(10.0, tenth / 10)
            sent += 10.0
    assert sent <= 100 * (10 + 1) + 100 * 10, "what ten seconds bring, and the charge that puts each stream in debt"


def test_reopened_session_gets_no_new_budget_of_prompts() -> None:
    peer = peer_of(prompts_per_second=20.0)
    first = peer.place(Priority.NEAR, 0.0)
    first.prompts.charge(60.0, 0.0)
    first.release()
    second = peer.place(Priority.NEAR, 0.0)
    second.prompts.charge(1.0, 0.0)
    assert second.prompts.owed_s(0.0) > 0


def test_session_changes_its_class_only_if_there_is_room() -> None:
    peer = peer_of(heroes=1, session_weight=6)
    crowd, hero = peer.place(Priority.CROWD, 0.0), peer.place(Priority.HERO, 0.0)
    for wanted, field in ((Priority.HERO, "set_options.priority"), (Priority.CROWD, ""), (Priority.NEAR, "")):
        if field:
            with pytest.raises(EventRefused) as refused:
                crowd.change(wanted, None)
            assert refused.value.field == field
        else:
            crowd.change(wanted, None)(True)
    assert peer.session_weight == 6
    other = peer_of(session_weight=5)
    places = [other.place(Priority.CROWD, 0.0) for _ in range(4)]
    places[0].change(Priority.NEAR, None)(True)
    with pytest.raises(EventRefused, match="as many sessions") as refused:
        places[1].change(Priority.NEAR, None)
    assert refused.value.field == "set_options.priority"
    hero.change(Priority.HERO, None)(True)  # the class that it has already is never refused
    for place in (crowd, hero, *places):
        place.release()
    assert (peer.num_sessions, other.num_sessions) == (0, 0)


def test_pending_changes_count_as_requested_and_refused_ones_as_before() -> None:
    peer = peer_of(steps_per_second=10.0, heroes=1)
    place, other = peer.place(Priority.CROWD, 0.0), peer.place(Priority.CROWD, 0.0)
    place.begin_steps(2.0)
    is_more = place.change(None, 8.0)
    is_hero = place.change(Priority.HERO, None)
    with pytest.raises(EventRefused):
        other.begin_steps(3.0)
    with pytest.raises(EventRefused):
        other.change(Priority.HERO, None)
    is_more(False)
    other.begin_steps(8.0)
    is_hero(False)
    is_hero(True)  # it has been answered already
    other.change(Priority.HERO, None)(True)
    place.change(None, 1.0)(True)
    other.change(None, 9.0)(True)
    assert [peer.session_weight, peer.num_sessions] == [5, 2]


def test_rounding_errors_of_steps_vanish_with_the_last_session() -> None:
    peer = peer_of(steps_per_second=0.7)
    places = [peer.place(Priority.NEAR, 0.0) for _ in range(3)]
    for place, steps_hz in zip(places, (0.1, 0.2, 0.3), strict=True):
        place.begin_steps(steps_hz)
    for place in places:
        place.release()
    peer.place(Priority.NEAR, 0.0).begin_steps(0.7)


def test_open_streams_share_equally_and_the_peer_is_idle_once_all_is_paid() -> None:
    peer = peer_of(events_per_second=96.0)
    for _ in range(3):
        peer.begin_stream()
    assert not peer.is_idle(0.0)
    streams = [StreamBudget(1e6, peer, 0.0) for _ in range(3)]
    for stream, tokens in zip(streams, (128.0, 128.0, 224.0), strict=True):
        stream.charge(tokens, 0.0)
    assert [each.owed_s(0.0) for each in streams] == [3.0, 3.0, 4.0], "a third of 96 each, or until all is paid"
    peer.end_stream()
    assert [each.owed_s(0.0) for each in streams[:2]] == [2.0, 2.0]
    peer.end_stream()
    assert streams[0].owed_s(0.0) == 1.0
    peer.end_stream()
    assert (peer.num_streams, peer.loop.num_peers) == (0, 0)
    assert (peer.is_idle(4.5), peer.is_idle(5.0)) == (False, True)
