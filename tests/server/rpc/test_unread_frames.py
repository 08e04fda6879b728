"""The send queue: which of the frames that wait count as unread."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.types import Chunk, Closed, CloseReason, Code, Outcome, Output
from motiongen_server.rpc.send_queue import UPDATE_OVERHEAD_BYTES, Run, SendQueue, size_of
from tests.server.rpc.test_send_queue import KEY, OTHER, WIDTH, chunk, frames, notice, put_all


def test_a_look_ahead_of_each_session_waits_without_being_excess() -> None:
    send_queue = SendQueue()
    send_queue.put_chunk(chunk(0, 4), 1, lookahead=12)
    send_queue.put_chunk(chunk(0, 10, key=OTHER), 1, lookahead=12)
    send_queue.put_chunk(chunk(8, 8), 1, lookahead=12)
    assert send_queue.excess_bytes == 0
    told = Outcome(KEY, 2, Code.OK)
    send_queue.put(told, 2)
    assert send_queue.excess_bytes == size_of(told)
    send_queue.put_chunk(chunk(16, 1), 1, lookahead=12)
    beyond = UPDATE_OVERHEAD_BYTES + WIDTH * 4
    assert send_queue.excess_bytes == size_of(told) + beyond, "the first frame beyond it"
    send_queue.put_chunk(chunk(17, 2), 1, lookahead=12)
    assert send_queue.excess_bytes == size_of(told) + beyond + 2 * WIDTH * 4
    send_queue.put(notice(2, 18), 3)
    assert send_queue.excess_bytes == size_of(told) + beyond + WIDTH * 4 + size_of(notice(2, 18))
    send_queue.drop_frames()
    assert send_queue.excess_bytes == send_queue.num_bytes == size_of(told) + size_of(notice(2, 18))
    send_queue.clear()
    assert send_queue.excess_bytes == 0


def test_only_frames_beyond_a_look_ahead_are_excess_however_they_come() -> None:
    """Otherwise a client of hundreds of sessions, one frame behind in each, would at once be as far behind as if it
    had read nothing."""
    send_queue = SendQueue()
    for first in range(0, 15, 5):
        send_queue.put_chunk(chunk(first, 5), 1, lookahead=12)
    assert send_queue.excess_bytes == 3 * WIDTH * 4
    send_queue.put(notice(2, 13), 2)
    assert send_queue.excess_bytes == WIDTH * 4 + size_of(notice(2, 13))
    send_queue.put(notice(3, 10), 3)
    told = size_of(notice(2, 13)) + size_of(notice(3, 10))
    assert send_queue.excess_bytes == told
    send_queue.put_chunk(chunk(10, 4, plan=3), 3, lookahead=12)
    assert send_queue.excess_bytes == told + 2 * WIDTH * 4
    send_queue.take(1 << 30)
    assert send_queue.excess_bytes == 0


def test_frames_of_a_session_that_is_over_are_all_excess() -> None:
    """A client may open and close any number of sessions."""
    send_queue = put_all(chunk(0, 4), notice(1, 8), chunk(8, 4), chunk(0, 2, key=OTHER), lookahead=12)
    before = send_queue.excess_bytes
    closed = Closed(KEY, CloseReason.CLIENT, Code.OK, "", 12, 0)
    send_queue.put(closed, 4)
    mine = 2 * UPDATE_OVERHEAD_BYTES + 8 * WIDTH * 4
    assert send_queue.excess_bytes == before + size_of(closed) + mine
    send_queue.put_chunk(chunk(0, 12), 1, lookahead=12)
    assert send_queue.excess_bytes == before + size_of(closed) + mine, "the handle's next session has its own"
    send_queue.take(1 << 30)
    assert send_queue.excess_bytes == 0


def test_frames_of_a_session_that_goes_on_elsewhere_are_not_sent() -> None:
    """A client could resume its sessions again and again, on the same stream, to have their frames kept each time."""
    closed = Closed(KEY, CloseReason.TAKEN_OVER, Code.OK, "", 0, 0)
    send_queue = put_all(chunk(0, 4), chunk(0, 2, key=OTHER), closed, lookahead=12)
    assert (send_queue.dropped_frames, send_queue.excess_bytes) == (4, size_of(closed))
    other, told = send_queue.take(1 << 30)
    assert isinstance(other, Run)
    assert (frames(other), told) == ([0, 1], (closed, 2))


SESSIONS = st.sampled_from([KEY, OTHER])
ENDS = st.sampled_from([CloseReason.CLIENT, CloseReason.TAKEN_OVER])


@given(
    st.lists(
        st.one_of(
            st.builds(chunk, st.integers(0, 30), st.integers(1, 12), key=SESSIONS),
            st.builds(notice, st.integers(1, 9), st.integers(0, 40), key=SESSIONS),
            st.builds(Closed, SESSIONS, ENDS, st.just(Code.OK), st.just(""), st.just(0), st.just(0)),
            st.integers(1, 800),
        ),
        max_size=40,
    ),
    st.integers(1, 30),
)
def test_no_more_than_a_look_ahead_of_each_handle_waits_without_being_excess(
    acts: list[Output | int], lookahead: int
) -> None:
    """Whatever happens to the sessions of a stream, and however they follow each other on its handles."""
    send_queue = SendQueue()
    for act in acts:
        if isinstance(act, int):
            send_queue.take(act)
        elif isinstance(act, Chunk):
            send_queue.put_chunk(act, 1, lookahead=lookahead)
        else:
            send_queue.put(act, 1)
        owed = send_queue.num_bytes - send_queue.excess_bytes
        assert 0 <= owed <= 2 * lookahead * (UPDATE_OVERHEAD_BYTES + WIDTH * 4)
    send_queue.take(1 << 30)
    assert send_queue.num_bytes == send_queue.excess_bytes == 0
