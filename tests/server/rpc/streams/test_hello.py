"""What a client says about the stream itself: its hello, its flush interval, and its measured round trip."""

from __future__ import annotations

import time

import pytest
from google.protobuf.duration_pb2 import Duration

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.engine.types import Playhead
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.errors.streams import hello_expected, hello_repeated
from motiongen_server.rpc.streams.reader import FLUSH_RANGE_S, MAX_AGENT_CHARACTERS, StreamReader
from tests.server.rpc.streams.test_event_order import Line


class Talk:
    """A stream and its reader."""

    def __init__(self, **reader: float) -> None:
        self.line = Line()
        self.stream = self.line.stream
        self.reader = StreamReader(self.line.models, "replica", **reader)

    def say(self, **said: object) -> None:
        self.reader._control(self.stream, service_pb2.StreamMotionRequest(**said))  # type: ignore[arg-type]

    def told(self) -> list[service_pb2.StreamMotionResponse]:
        return list(self.stream.responses)


HELLO = service_pb2.ClientHello(client_agent="a" * MAX_AGENT_CHARACTERS)


@pytest.mark.parametrize(
    ("asked", "given_s"),
    [
        (None, 0.02),
        (Duration(nanos=50_000_000), 0.05),
        (Duration(nanos=1), FLUSH_RANGE_S[0]),
        (Duration(seconds=1, nanos=5), FLUSH_RANGE_S[1]),
        (Duration(seconds=-(2**62)), FLUSH_RANGE_S[0]),
    ],
)
async def test_flush_interval_is_what_the_client_asks_for_within_bounds(asked: Duration | None, given_s: float) -> None:
    talk = Talk()
    talk.stream.flush_s = 0.02
    talk.say(hello=service_pb2.ClientHello(flush_interval=asked))
    assert talk.stream.flush_s == given_s
    (answer,) = talk.told()
    assert answer.hello.replica_id == "replica"
    assert talk.stream.greeted


async def test_hello_must_come_first_and_once_and_not_be_too_long() -> None:
    talk = Talk()
    with pytest.raises(StreamRefused, match=str(MAX_AGENT_CHARACTERS)):
        talk.say(hello=service_pb2.ClientHello(client_agent="a" * (MAX_AGENT_CHARACTERS + 1)))
    with pytest.raises(StreamRefused) as early:
        talk.say(ping=service_pb2.Ping())
    assert (talk.told(), talk.stream.greeted) == ([], False)
    talk.say(hello=HELLO)
    with pytest.raises(StreamRefused) as again:
        talk.say(hello=HELLO)
    assert (early.value.reason, again.value.reason) == (hello_expected().reason, hello_repeated().reason)
    (answer,) = talk.told()
    assert answer.hello.limits == talk.line.models.limits_message
    assert answer.hello.server_time_ns > 0


async def test_playheads_carry_the_round_trip_that_the_client_measured() -> None:
    talk = Talk()
    talk.say(hello=HELLO)
    talk.line.open()
    rounds = (None, Duration(nanos=250_000_000), None)
    for round_trip in rounds:
        talk.say(ping=service_pb2.Ping(client_time_ns=7, round_trip=round_trip))
        talk.line.send(0, playhead=session_pb2.Playhead(frame=3))
    reports = [event for event in talk.line.engine.events if isinstance(event, Playhead)]
    assert [report.rtt_s for report in reports] == [None, 0.25, None]
    assert [each.pong.client_time_ns for each in talk.told()[1:]] == [7, 7, 7]
    times_ns = [each.pong.server_time_ns for each in talk.told()[1:]]
    assert all(time_ns > 0 for time_ns in times_ns)


async def test_client_of_a_draining_server_gets_goodbye_after_the_hello() -> None:
    talk = Talk(reconnect_after_s=2.0)
    talk.reader.ends_at = time.monotonic() + 10.0
    talk.say(hello=HELLO)
    hello, goodbye = talk.told()
    assert hello.HasField("hello")
    assert goodbye.goodbye.reason == service_pb2.GOODBYE_REASON_DRAINING
    assert 0 < goodbye.goodbye.grace.ToMilliseconds() <= 10_000
    assert goodbye.goodbye.reconnect_after.ToMilliseconds() == 2_000
