"""Output that waits to be written on a stream: how many bytes count, which frames are dropped, and what is urgent."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen.v1 import service_pb2
from motiongen_server.engine.types import Chunk, PlanCause, PlanNotice
from motiongen_server.rpc.stream_metrics import NoStreamMetrics
from motiongen_server.rpc.streams.output import REPLY_BYTES
from tests.server.rpc.streams.test_event_order import Line

PONG = service_pb2.StreamMotionResponse(pong=service_pb2.Pong(client_time_ns=1))


class Metrics(NoStreamMetrics):
    """Notes how many frames were dropped each time."""

    def __init__(self) -> None:
        self.dropped: list[int] = []

    def drop_frames(self, count: int) -> None:
        self.dropped.append(count)


@pytest.fixture
async def line() -> Line:
    return Line(metrics=Metrics())


async def test_message_being_written_counts_as_waiting_until_it_is_written(line: Line) -> None:
    stream = line.stream
    for _ in range(2):
        stream.reply(PONG)
    assert stream.num_waiting_bytes == 2 * REPLY_BYTES
    line.open()
    queued = stream.send_queue.num_bytes
    assert stream.num_waiting_bytes == 2 * REPLY_BYTES + queued
    response = stream.next_response()
    assert response == PONG.SerializeToString(), "pongs go first"
    assert stream.num_waiting_bytes == REPLY_BYTES + queued + len(response)
    stream.note_written()
    assert stream.num_waiting_bytes == REPLY_BYTES + queued
    stream.next_response()
    response = stream.next_response()
    assert response is not None
    assert stream.num_waiting_bytes == len(response)
    assert stream.next_response() is None
    assert stream.num_waiting_bytes == 0


async def test_probe_is_done_once_a_message_sent_after_it_is_written(line: Line) -> None:
    stream = line.stream
    stream.reply(PONG)
    assert stream.next_response() is not None
    is_there = stream.probe()
    stream.note_written()
    assert not is_there.done(), "that message was on its way before the probe"
    assert stream.next_response() == b""
    assert not is_there.done()
    stream.note_written()
    assert is_there.done()


async def test_unsent_frames_replaced_by_a_plan_are_counted_once(line: Line) -> None:
    metrics = line.metrics
    assert isinstance(metrics, Metrics)
    line.open()
    key = line.engine.events[0].session
    line.stream.take(Chunk(key, 1, 0, np.zeros((40, 3), np.float32), 20))
    assert metrics.dropped == []
    line.stream.take(PlanNotice(key, 2, 30, PlanCause.EDIT, ()))
    line.stream.take(PlanNotice(key, 3, 25, PlanCause.EDIT, ()))
    line.updates()
    assert metrics.dropped == [10, 5]


async def test_pongs_and_the_end_do_not_wait_for_the_flush_interval(line: Line) -> None:
    stream = line.stream
    line.open()
    assert not stream.urgent.is_set()
    stream.reply(PONG)
    assert stream.urgent.is_set()
    stream.urgent.clear()
    stream.end()
    assert stream.urgent.is_set()
