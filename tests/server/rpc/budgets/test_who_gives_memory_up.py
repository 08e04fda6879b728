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
