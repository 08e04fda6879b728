"""A session's events beyond its rate are refused, except for the one that ends it."""

from __future__ import annotations

import time

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Close, Open, Opened, SetPlayState
from tests.server.rpc.streams.test_event_order import PAUSE, Line, make_catalog


async def test_session_whose_events_come_too_fast_can_be_closed() -> None:
    line = Line(make_catalog(events_per_second=2.0))
    now = time.monotonic()
    line.send(1, now, open=session_pb2.OpenSession())
    line.stream.take(Opened(line.engine.events[-1].session, 1, 0, 40, 4, 4, "tiny", "stick", 20))
    for event_seq in (2, 3):
        line.send(event_seq, now, set_play_state=PAUSE)
    assert [seq for seq, _ in line.refusals()] == [3]
    line.send(4, now, close=session_pb2.CloseSession())
    assert line.engine.kinds() == [Open, SetPlayState, Close]
