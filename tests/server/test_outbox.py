"""The outbox: order, what a plan supersedes, and how many bytes wait."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from server.engine.types import Chunk, Code, Outcome, Output, PlanCause, PlanNotice, SessionKey
from server.outbox import Outbox, size_of

KEY, OTHER = SessionKey(1, 1), SessionKey(1, 2)
WIDTH = 5


def chunk(first: int, count: int, plan: int = 1, key: SessionKey = KEY) -> Chunk:
    rows = np.arange(first, first + count, dtype=np.float32)[:, None].repeat(WIDTH, axis=1)
    return Chunk(key, plan, first, rows, 0)


def notice(plan: int, valid_from: int, key: SessionKey = KEY) -> PlanNotice:
    return PlanNotice(key, plan, valid_from, PlanCause.EDIT, (plan,))


def put_all(*outputs: Output) -> Outbox:
    outbox = Outbox()
    for number, output in enumerate(outputs):
        outbox.put(output, number)
    return outbox


def taken(outbox: Outbox, max_bytes: int = 1 << 30) -> list[Output]:
    return [output for output, _ in outbox.take(max_bytes)]


def test_outputs_come_out_in_order_with_the_number_they_went_in_with() -> None:
    outputs = [notice(1, 0), chunk(0, 4), Outcome(KEY, 2, Code.OK), chunk(4, 4)]
    assert put_all(*outputs).take(1 << 30) == list(zip(outputs, range(4), strict=True))


def test_a_plan_takes_out_the_frames_it_replaces_and_leaves_those_below() -> None:
    outbox = put_all(chunk(0, 4), chunk(4, 8), chunk(12, 4), chunk(0, 20, key=OTHER), notice(2, 6))
    left = taken(outbox)
    assert [(one.session, one.first_frame, len(one.rows)) for one in left if isinstance(one, Chunk)] == [
        (KEY, 0, 4),
        (KEY, 4, 2),
        (OTHER, 0, 20),
    ]
    assert isinstance(left[-1], PlanNotice)
    assert outbox.dropped_frames == 10


def test_a_message_is_filled_up_to_its_limit_but_never_empty() -> None:
    one = size_of(chunk(0, 4))
    outbox = put_all(chunk(0, 4), chunk(4, 4), chunk(8, 4))
    assert len(outbox.take(2 * one)) == 2
    assert len(outbox.take(1)) == 1
    assert outbox.take(1) == []
    assert outbox.num_bytes == 0


@given(
    st.lists(
        st.one_of(
            st.builds(chunk, st.integers(0, 30), st.integers(1, 12), key=st.sampled_from([KEY, OTHER])),
            st.builds(notice, st.integers(1, 9), st.integers(0, 40), key=st.sampled_from([KEY, OTHER])),
        ),
        max_size=30,
    ),
    st.integers(1, 800),
)
def test_bytes_are_those_of_what_waits_and_frames_below_a_plan_survive(outputs: list[Output], max_bytes: int) -> None:
    outbox = put_all(*outputs)
    waiting = outbox.num_bytes
    came: list[Output] = []
    while batch := taken(outbox, max_bytes):
        came += batch
        waiting -= sum(size_of(output) for output in batch)
        assert outbox.num_bytes == waiting
    assert len(outbox) == waiting == 0
    expected = 0
    for index, output in enumerate(outputs):
        if isinstance(output, Chunk):
            later = [
                each.valid_from
                for each in outputs[index:]
                if isinstance(each, PlanNotice) and each.session == output.session
            ]
            expected += max(0, min([*later, output.first_frame + len(output.rows)]) - output.first_frame)
    assert sum(len(output.rows) for output in came if isinstance(output, Chunk)) == expected
