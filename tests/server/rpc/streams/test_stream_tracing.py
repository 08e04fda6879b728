"""Traces of windows: when the first frame of each was written, or that it will not be."""

from __future__ import annotations

from typing import Any

import numpy as np

from motiongen_server.engine.types import Chunk, PlanCause, PlanNotice, SessionKey
from motiongen_server.engine.types.tracing import WindowTiming, WindowTrace
from motiongen_server.rpc.send_queue import SendQueue
from motiongen_server.rpc.streams.tracing import StreamTracing

TIMING = WindowTiming(1.0, 1.1, 1.2, 1.5, 4, "pid 7")


class Opened:
    """The part of an opened session that traces report."""

    session_id, model_id = "1-1-abc", "fake"


class Entry:
    """A session of a stream, by its handle."""

    def __init__(self, handle: int) -> None:
        self.handle, self.request_id, self.opened = handle, f"request {handle}", Opened()


class Traced:
    """A stream's queue, its tracing, and the traces it has reported. now: the time of its clock."""

    def __init__(self) -> None:
        self.now = 2.0
        self.told: list[WindowTrace] = []
        self.queue = SendQueue()
        self.tracing = StreamTracing(self.told.append, lambda: self.now)

    def plan(self, handle: int, plan: int, timing: WindowTiming | None = TIMING, num_events: int = 1) -> None:
        key, entry = SessionKey(1, handle), Entry(handle)
        seqs = tuple(range(1, 1 + num_events))
        notice = PlanNotice(key, plan, 8 * plan, PlanCause.EDIT, seqs, timing)
        self.tracing.announce(notice, entry)  # type: ignore[arg-type]
        self.queue.put(notice, 0)

    def chunk(self, handle: int, plan: int) -> None:
        self.queue.put_chunk(Chunk(SessionKey(1, handle), plan, 8 * plan, np.zeros((4, 3), np.float32), 0), 0)

    def write(self, at: float) -> None:
        self.tracing.take(self.queue.take(1 << 20))
        self.now = at
        self.tracing.note_written()


def told(traced: Traced) -> list[tuple[int, bool, float]]:
    return [(trace.plan, trace.is_sent, trace.sent_at) for trace in traced.told]


def test_window_is_traced_once_when_its_first_frame_is_written() -> None:
    traced = Traced()
    traced.plan(1, 1, num_events=2)
    traced.chunk(1, 1)
    assert traced.told == []
    traced.write(3.0)
    traced.chunk(1, 1)
    traced.write(4.0)
    (trace,) = traced.told
    expected: dict[str, Any] = {
        "timing": TIMING, "session": "1-1-abc", "request_id": "request 1", "model_id": "fake", "plan": 1,
        "first_frame": 8, "cause": PlanCause.EDIT, "num_events": 2, "sent_at": 3.0, "is_sent": True,
    }  # fmt: skip
    assert trace == WindowTrace(**expected)


def test_plan_written_without_frames_is_traced_with_its_first_frames() -> None:
    traced = Traced()
    traced.plan(1, 1)
    traced.write(3.0)
    assert traced.told == []
    traced.chunk(1, 1)
    traced.write(5.0)
    assert told(traced) == [(1, True, 5.0)]


def test_plan_replaced_before_it_is_written_is_traced_as_not_sent() -> None:
    traced = Traced()
    traced.plan(1, 1)
    traced.plan(1, 2)
    traced.chunk(1, 2)
    traced.write(3.0)
    assert told(traced) == [(1, False, 2.0), (2, True, 3.0)]


def test_plan_replaced_while_being_written_is_traced_as_sent() -> None:
    """A write to a slow reader takes long."""
    traced = Traced()
    traced.plan(1, 1)
    traced.chunk(1, 1)
    traced.tracing.take(traced.queue.take(1 << 20))
    traced.plan(1, 2)
    traced.chunk(1, 2)
    traced.now = 3.0
    traced.tracing.note_written()
    traced.write(4.0)
    assert told(traced) == [(1, True, 3.0), (2, True, 4.0)]


def test_plan_being_written_when_its_stream_ends_is_traced_as_not_sent() -> None:
    traced = Traced()
    traced.plan(1, 1)
    traced.chunk(1, 1)
    traced.tracing.take(traced.queue.take(1 << 20))
    traced.plan(1, 2)
    traced.tracing.end_all()
    traced.tracing.note_written()
    assert told(traced) == [(1, False, 2.0), (2, False, 2.0)]


def test_frames_of_an_older_plan_do_not_count_for_the_newest_plan() -> None:
    traced = Traced()
    traced.chunk(1, 1)
    traced.plan(1, 2)
    traced.write(3.0)
    assert traced.told == []


def test_sessions_of_a_stream_are_traced_separately() -> None:
    traced = Traced()
    traced.plan(1, 1)
    traced.plan(2, 5)
    traced.chunk(2, 5)
    traced.write(3.0)
    assert [(trace.session, trace.plan) for trace in traced.told] == [("1-1-abc", 5)]
    assert traced.told[0].request_id == "request 2"


def test_unwritten_plans_are_traced_as_not_sent_at_the_stream_s_end() -> None:
    traced = Traced()
    traced.plan(1, 1)
    traced.tracing.end_all()
    traced.tracing.end_all()
    assert told(traced) == [(1, False, 2.0)]


def test_a_plan_without_a_window_has_no_trace() -> None:
    traced = Traced()
    traced.plan(1, 1, timing=None)
    traced.chunk(1, 1)
    traced.write(3.0)
    assert traced.told == []
