"""Which of several gives up memory where too much waits."""

from __future__ import annotations

from motiongen_server.engine.types import Code, Outcome, SessionKey
from motiongen_server.rpc.budgets.waiting_memory import WaitingMemory
from motiongen_server.rpc.clip.holding import Holding
from motiongen_server.rpc.send_queue import size_of
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from tests.server.rpc.budgets.test_waiting_memory import parked
from tests.server.rpc.sessions.test_kept_sessions import token_of
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, Line
from tests.server.rpc.streams.test_stream_watch import holding


async def test_largest_holder_of_the_peer_with_the_most_is_ended() -> None:
    """A client with one large stream must not lose it to those that hold more on many small ones."""
    large = holding(300)
    small = [Holding(each * large.num_waiting_bytes // 20, peer_name="ipv4:10.0.0.7") for each in (8, 9, 10)]
    memory = WaitingMemory(2 * large.num_waiting_bytes, {1: large})
    for number, call in enumerate(small):
        memory.begin(number, call)
    memory.bound()
    assert large.refusal is None
    assert [each.refusal is not None for each in small] == [False, False, True]
    memory = WaitingMemory(large.num_waiting_bytes * 6 // 5, {1: large})
    for number, call in enumerate(small[:2]):
        memory.begin(number, call)
    memory.bound()
    assert large.refusal is not None
    assert [each.refusal for each in small[:2]] == [None, None]


async def test_placements_of_absent_clients_are_not_dropped_for_what_another_peer_does_not_read() -> None:
    kept = KeptSessions(30.0)
    _, token = parked(kept)
    entry = kept.find(token)
    assert entry is not None
    before = entry.held_bytes
    others = [Holding(before * half // 2, peer_name="ipv4:10.0.0.7") for half in (4, 5)]
    memory = WaitingMemory(5 * before, {}, kept)
    for number, call in enumerate(others):
        memory.begin(number, call)
    memory.bound()
    assert [call.refusal is not None for call in others] == [False, True]
    assert entry.held_bytes == before
    memory.end(1)
    memory.begin(2, own := Holding(before * 5 // 2))
    memory.bound()
    assert own.refusal is None, "its peer holds the most, and its session can spare this"
    assert entry.held_bytes < before


async def test_parked_sessions_of_the_peer_with_the_most_give_first() -> None:
    """A client with one large session must not lose it for those that hold more on many small ones."""
    kept = KeptSessions(30.0)
    large, *small = (kept.find(parked(kept, number)[1]) for number in range(1, 6))
    assert large is not None
    for entry in small:
        assert entry is not None
        entry.place.peer.name = "ipv4:10.0.0.7"
    large.answers.keep(Outcome(large.key, 3, Code.OK))
    held = large.held_bytes
    kept.let_go(1, 0)
    assert (large.held_bytes, kept.num_parked) == (held, 5)
    for entries in kept.by_peer().values():
        for entry in entries:
            entry.let_go_of_places()
    kept.let_go(held := large.held_bytes, 0)
    assert (large.held_bytes, kept.num_parked) == (held, 3), "two of the others, which held twice as much together"


async def test_sessions_are_given_up_by_what_they_hold_without_placements() -> None:
    """A session with one answer, which had placements, holds less in the end than one with two."""
    kept = KeptSessions(30.0)
    (_, placed), line = parked(kept), Line(kept=kept, number=2)
    line.open()
    answers = [Outcome(SessionKey(2, HANDLE), event_seq, Code.OK) for event_seq in (2, 3)]
    for answer in answers:
        line.send(answer.event_seq, set_play_state=PAUSE)
        line.stream.take(answer)
    line.stream.lose()
    kept.let_go(1 << 30, size_of(answers[0]))
    assert (kept.find(placed) is not None, kept.find(token_of(line))) == (True, None)
