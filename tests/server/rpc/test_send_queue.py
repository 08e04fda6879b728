"""The send queue: order, what is sent together, what a plan supersedes, and how many bytes wait."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.types import (
    Chunk,
    Closed,
    CloseReason,
    Code,
    Opened,
    Outcome,
    Output,
    Placement,
    PlanCause,
    PlanNotice,
    SessionKey,
    Warned,
)
from motiongen_server.rpc.send_queue import MAX_RUN_FRAMES, UPDATE_OVERHEAD_BYTES, Run, SendQueue, size_of
from motiongen_server.rpc.streams.response import response_of

KEY, OTHER = SessionKey(1, 1), SessionKey(1, 2)
WIDTH = 5
PLACED = Placement(2**32 - 1, *[2**53] * 4, 1.0, 2.0, 3.0)
WARNED = (Warned("R" * 30, "m" * 200, "f" * 30),) * 3


def chunk(first: int, count: int, plan: int = 1, key: SessionKey = KEY) -> Chunk:
    rows = np.arange(first, first + count, dtype=np.float32)[:, None].repeat(WIDTH, axis=1)
    return Chunk(key, plan, first, rows, first)


def notice(plan: int, valid_from: int, key: SessionKey = KEY) -> PlanNotice:
    return PlanNotice(key, plan, valid_from, PlanCause.EDIT, (plan,))


def put_all(*outputs: Output, lookahead: int = 0) -> SendQueue:
    send_queue = SendQueue()
    for number, output in enumerate(outputs):
        if isinstance(output, Chunk):
            send_queue.put_chunk(output, number, lookahead=lookahead)
        else:
            send_queue.put(output, number)
    return send_queue


def frames(run: Run) -> list[int]:
    """The numbers of a run's frames, which the rows of these tests contain; checked against the run's own numbers."""
    numbers = [int(row[0]) for part in run.parts for row in part]
    assert numbers == list(range(run.first_frame, run.first_frame + run.num_frames))
    return numbers


def num_bytes(item: Run | tuple[Output, int]) -> int:
    if isinstance(item, Run):
        return UPDATE_OVERHEAD_BYTES + len(frames(item)) * WIDTH * 4
    return size_of(item[0])


def test_outputs_are_taken_in_order_with_the_numbers_they_were_put_with() -> None:
    outcome = Outcome(KEY, 2, Code.OK)
    first, run, answer, later = put_all(notice(1, 0), chunk(0, 4), outcome, chunk(4, 4)).take(1 << 30)
    assert (first, answer) == ((notice(1, 0), 0), (outcome, 2))
    assert isinstance(run, Run)
    assert isinstance(later, Run)
    assert (frames(run), run.applied_seq) == ([0, 1, 2, 3], 1)
    assert (frames(later), later.applied_seq) == ([4, 5, 6, 7], 3)


def test_consecutive_frames_are_joined_across_outputs_of_other_sessions() -> None:
    run, other = put_all(chunk(0, 4), chunk(0, 2, key=OTHER), chunk(4, 4)).take(1 << 30)
    assert isinstance(run, Run)
    assert isinstance(other, Run)
    assert (run.handle, frames(run), run.committed_to) == (KEY.handle, list(range(8)), 4)
    assert (other.handle, frames(other)) == (OTHER.handle, [0, 1])


def test_another_plan_a_gap_or_a_full_run_starts_a_new_run() -> None:
    send_queue = put_all(chunk(0, 4), chunk(4, 4, plan=2), chunk(9, 4, plan=2), chunk(13, MAX_RUN_FRAMES, plan=2))
    assert [frames(item) for item in send_queue.take(1 << 30) if isinstance(item, Run)] == [
        [0, 1, 2, 3],
        [4, 5, 6, 7],
        [9, 10, 11, 12],
        list(range(13, 13 + MAX_RUN_FRAMES)),
    ]


def test_plan_removes_the_frames_it_replaces_and_keeps_earlier_ones() -> None:
    send_queue = put_all(chunk(0, 4), chunk(4, 8), chunk(12, 4), chunk(0, 20, key=OTHER), notice(2, 6))
    mine, other, told = send_queue.take(1 << 30)
    assert isinstance(mine, Run)
    assert isinstance(other, Run)
    assert (frames(mine), frames(other)) == (list(range(6)), list(range(20)))
    assert told == (notice(2, 6), 4)
    assert send_queue.dropped_frames == 10


def test_taken_run_is_neither_extended_nor_cut() -> None:
    """A run that was taken is being written: frames added to it would be lost, and counted for ever."""
    send_queue = put_all(chunk(0, 4), notice(2, 8), chunk(8, 4, plan=2))
    first, _, second = send_queue.take(10_000)
    assert (len(send_queue), send_queue.num_bytes) == (0, 0)
    send_queue.put_chunk(chunk(12, 4, plan=2), 3)
    assert isinstance(first, Run)
    assert isinstance(second, Run)
    (later,) = send_queue.take(10_000)
    assert isinstance(later, Run)
    assert (frames(first), frames(second), frames(later)) == ([*range(4)], [*range(8, 12)], [*range(12, 16)])
    send_queue.put(notice(3, 0), 4)
    assert send_queue.dropped_frames == 0


def test_plan_cuts_only_runs_that_were_not_taken() -> None:
    send_queue = put_all(chunk(0, 4), chunk(8, 4), chunk(16, 4))
    (first,) = send_queue.take(1)
    (second,) = send_queue.take(1)
    send_queue.put(notice(2, 0), 5)
    assert send_queue.dropped_frames == 4, "the third run's frames, and none of a run that was taken"
    assert isinstance(first, Run)
    assert isinstance(second, Run)
    assert (frames(first), frames(second)) == ([*range(4)], [*range(8, 12)])
    assert [type(item) for item in send_queue.take(10_000)] == [tuple], "only the plan is left"
    assert send_queue.num_bytes == 0


def test_frames_join_the_newest_run_unless_its_session_had_other_output() -> None:
    send_queue = put_all(chunk(0, 4), chunk(8, 4), chunk(12, 4), Outcome(KEY, 2, Code.OK), chunk(16, 4))
    runs = [item for item in send_queue.take(10_000) if isinstance(item, Run)]
    assert [frames(run) for run in runs] == [[*range(4)], [*range(8, 16)], [*range(16, 20)]]
    assert [run.applied_seq for run in runs] == [0, 1, 4]


def test_frames_do_not_join_a_run_that_was_dropped() -> None:
    """Otherwise they would be sent with an `applied_seq` from before the events in between."""
    send_queue = put_all(chunk(0, 8))
    send_queue.drop_frames()
    send_queue.put_chunk(chunk(0, 4), 5)
    (run,) = send_queue.take(10_000)
    assert isinstance(run, Run)
    assert (frames(run), run.applied_seq) == ([*range(4)], 5)


def test_cleared_queue_is_empty_and_later_frames_start_a_new_run() -> None:
    send_queue = put_all(notice(1, 0), chunk(0, 4))
    send_queue.clear()
    assert (len(send_queue), send_queue.num_bytes, send_queue.take(10_000)) == (0, 0, [])
    send_queue.put_chunk(chunk(4, 4), 3)
    (run,) = send_queue.take(10_000)
    assert isinstance(run, Run)
    assert frames(run) == [*range(4, 8)]


def test_plan_keeps_the_frames_of_the_previous_session_on_its_handle() -> None:
    closed = Closed(KEY, CloseReason.CLIENT, Code.OK, "", 4, 0)
    run, _, _ = put_all(chunk(0, 4), closed, notice(1, 0)).take(1 << 30)
    assert isinstance(run, Run)
    assert frames(run) == [0, 1, 2, 3]


def test_plan_cuts_its_frames_after_those_of_the_previous_session_were_taken() -> None:
    send_queue = put_all(chunk(0, 4), Closed(KEY, CloseReason.CLIENT, Code.OK, "", 4, 0), chunk(0, 8))
    send_queue.take(1)
    send_queue.put(notice(2, 6), 3)
    assert send_queue.dropped_frames == 2


def test_drop_frames_keeps_all_other_outputs() -> None:
    send_queue = put_all(chunk(0, 4), Outcome(KEY, 2, Code.OK), chunk(4, 4), chunk(0, 3, key=OTHER))
    send_queue.drop_frames()
    assert send_queue.dropped_frames == 11
    assert send_queue.num_bytes == size_of(Outcome(KEY, 2, Code.OK))
    assert send_queue.take(1 << 30) == [(Outcome(KEY, 2, Code.OK), 1)]


def test_take_fills_a_message_to_its_limit_but_takes_at_least_one_run() -> None:
    send_queue = put_all(chunk(0, 4), chunk(8, 4), chunk(16, 4))
    one = send_queue.num_bytes // 3
    assert len(send_queue.take(2 * one)) == 2
    assert len(send_queue.take(1)) == 1
    assert send_queue.take(1) == []
    assert send_queue.num_bytes == 0


@given(
    st.lists(
        st.one_of(
            st.builds(chunk, st.integers(0, 30), st.integers(1, 12), key=st.sampled_from([KEY, OTHER])),
            st.builds(notice, st.integers(1, 9), st.integers(0, 40), key=st.sampled_from([KEY, OTHER])),
        ),
        max_size=30,
    ),
    st.integers(1, 800),
    st.sampled_from([0, 12, 30]),
)
def test_num_bytes_counts_what_waits_and_frames_before_a_plan_survive(
    outputs: list[Output], max_bytes: int, lookahead: int
) -> None:
    send_queue = put_all(*outputs, lookahead=lookahead)
    waiting, excess = send_queue.num_bytes, send_queue.excess_bytes
    came: dict[int, list[int]] = {KEY.handle: [], OTHER.handle: []}
    while batch := send_queue.take(max_bytes):
        waiting -= sum(map(num_bytes, batch))
        assert send_queue.num_bytes == waiting
        excess -= sum(item.excess_bytes if isinstance(item, Run) else num_bytes(item) for item in batch)
        assert send_queue.excess_bytes == excess
        for item in batch:
            if isinstance(item, Run):
                came[item.handle] += frames(item)
    assert len(send_queue) == waiting == excess == 0
    for key in (KEY, OTHER):
        expected: list[int] = []
        for index, output in enumerate(outputs):
            if isinstance(output, Chunk) and output.session == key:
                plans = (each for each in outputs[index:] if isinstance(each, PlanNotice) and each.session == key)
                end = min((each.valid_from for each in plans), default=1 << 30)
                last = output.first_frame + len(output.rows)
                expected += [frame for frame in range(output.first_frame, last) if frame < end]
        assert came[key.handle] == expected


@pytest.mark.parametrize(
    "output",
    [
        Outcome(KEY, 2**63, Code.OK, 2**53, warnings=WARNED, placements=(PLACED,) * 256),
        Outcome(KEY, 2**63, Code.OK, 2**53, warnings=WARNED),
        Outcome(KEY, 2**63, Code.NOT_FOUND, None, "R" * 30, "m" * 200, "f" * 30, "a" * 100),
        Opened(KEY, 1, 0, 40, 4, 4, "tiny", "stick", 20, WARNED, placements=(PLACED,) * 256),
        PlanNotice(KEY, 1, 0, PlanCause.EDIT, (2**63,) * 256),
    ],
    ids=lambda output: type(output).__name__,
)
def test_size_of_an_output_is_at_least_its_bytes_and_less_than_twice_them(output: Output) -> None:
    num_bytes = len(response_of([(output, 2**53)]))
    assert num_bytes <= size_of(output) < 2 * num_bytes
