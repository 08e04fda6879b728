"""Event loop time is charged to the senders of the messages that took it, by a clock that the tests move."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field
from typing import cast

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import Chunk, Code, Outcome, SessionKey
from motiongen_server.rpc.budgets.loop_time import MOST_TIMES, REFUSED_TIMES, Clocks, LoopTime, Work
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.peers import Peers
from motiongen_server.rpc.budgets.stream_budget import StreamBudget
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.streams import take_overs as stream_take_overs
from motiongen_server.rpc.streams.reader import EVENTS_A_TURN, StreamReader
from motiongen_server.rpc.streams.response import response_of
from motiongen_server.rpc.streams.stream import Stream
from tests.server.rpc.streams.test_event_order import HANDLE, Line

HELLO = service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()).SerializeToString()
LONG_S = 0.2
"""The loop time of a message here: half of what all may take in a second."""


@dataclass
class Clock:
    """A clock that stands still except when work takes time."""

    now_s: float = 0.0

    def __call__(self) -> float:
        return self.now_s


@dataclass
class Ticks:
    """A clock that advances by a millisecond whenever it is read, which is what each piece of work takes."""

    num_read: int = 0

    def __call__(self) -> float:
        self.num_read += 1
        return self.num_read / 1000


def peer_of(loop: LoopTime, num_streams: int = 1) -> Peer:
    peer = Peer(PeerLimits(), 0.0, loop=loop)
    for _ in range(num_streams):
        peer.begin_stream()
    return peer


def test_nested_work_counts_once_and_waits_do_not_count() -> None:
    clock, charged = Clock(), list[float]()
    loop = LoopTime(0.4, 0.0, Clocks(clock, clock))
    work = Work(loop, charged.append)
    with work:
        clock.now_s += 0.05
        with work:
            clock.now_s += 0.01
        work.end()
        clock.now_s += 100.0  # other tasks have their turn
        work.begin()
        clock.now_s += 0.02
    assert charged == [pytest.approx(0.06), pytest.approx(0.02)]
    assert loop.taken_s == pytest.approx(0.08)


def test_failed_work_is_charged_and_a_suspended_machine_is_not() -> None:
    clock, charged = Clock(), list[float]()
    computing = Clock()
    work = Work(LoopTime(0.4, 0.0, Clocks(clock, computing)), charged.append)

    def fail() -> None:
        with work:
            clock.now_s += 0.05
            computing.now_s += 0.04
            raise ValueError("wrong")

    with pytest.raises(ValueError, match="wrong"):
        fail()
    with work:
        clock.now_s += 60.0  # the machine was suspended
        computing.now_s += 0.01
    assert charged == [pytest.approx(0.05), pytest.approx(MOST_TIMES * 0.01)]


def test_work_for_refused_events_is_charged_several_times() -> None:
    clock, charged = Clock(), list[float]()
    loop = LoopTime(0.4, 0.0, Clocks(clock, clock))
    work = Work(loop, charged.append)
    for num_refused in (0, 1, 4, 0):
        with work:
            clock.now_s += 0.01
            work.num_events += 4
            work.num_refused += num_refused
    each = [0.01, 0.01 * (3 + REFUSED_TIMES) / 4, 0.01 * REFUSED_TIMES, 0.01]
    assert charged == pytest.approx(each)
    assert loop.taken_s == pytest.approx(0.04), "the time itself is counted once"


def test_only_streams_beyond_their_part_wait() -> None:
    peer = peer_of(LoopTime(0.4, 0.0), num_streams=4)
    greedy, modest = StreamBudget(1e9, peer, 0.0), StreamBudget(1e9, peer, 0.0)
    greedy.charge_loop(0.4, 0.0)
    assert greedy.owed_s(0.0) == 0, "a second's worth is free"
    greedy.charge_loop(0.1, 0.0)
    # A quarter of the loop time is its part: a tenth of a second comes back each second.
    assert greedy.loop_owed_s(0.0) == pytest.approx(1.0)
    assert greedy.owed_s(0.0) == greedy.loop_owed_s(0.0)
    modest.charge_loop(0.09, 0.0)
    assert modest.owed_s(0.0) == 0


def test_time_taken_while_there_was_plenty_is_not_owed_later() -> None:
    peer = peer_of(LoopTime(0.4, 0.0), num_streams=4)
    large, hostile = StreamBudget(1e9, peer, 0.0), StreamBudget(1e9, peer, 0.0)
    for second in range(1000):
        large.charge_loop(0.3, float(second))  # three times its part
        assert large.owed_s(float(second)) == 0
    hostile.charge_loop(0.5, 1000.0)
    assert hostile.owed_s(1000.0) > 0
    assert large.owed_s(1000.0) == 0
    large.charge_loop(0.05, 1000.0)
    assert large.loop_owed_s(1000.0) <= 0.5


def test_peers_have_equal_parts_however_many_their_streams() -> None:
    peers = Peers(PeerLimits(), LoopTime(0.4, 0.0))
    many, one = peers.find("ipv4:10.0.0.1:5", 0.0), peers.find("ipv4:10.0.0.2:5", 0.0)
    hostile = []
    for _ in range(50):
        hostile.append(StreamBudget(1e9, many, 0.0))
        many.begin_stream()
    one.begin_stream()
    good = StreamBudget(1e9, one, 0.0)
    for budget in hostile:
        budget.charge_loop(0.03, 0.0)
    for tenth in range(1, 20):
        good.charge_loop(0.019, tenth / 10)  # nearly half of all
        assert good.owed_s(tenth / 10) == 0
    assert all(budget.owed_s(0.0) > 0 for budget in hostile[20:])
    for _ in range(50):
        many.end_stream()
    one.end_stream()
    assert many.loop.num_peers == 0


def test_streams_never_wait_without_a_limit() -> None:
    budget = StreamBudget(1e9, Peer(PeerLimits(), 0.0), 0.0)
    for _ in range(1000):
        budget.charge_loop(1.0, 0.0)
    assert budget.owed_s(0.0) == 0


# ---- a stream --------------------------------------------------------------------------------------------------------


@dataclass
class Context:
    """The context of a client that sends hello, then messages of some events each, as often as it is read."""

    num_events: int = 1
    num_read: int = 0
    sent: list[bytes] = field(default_factory=lambda: [HELLO])

    async def read(self) -> bytes:
        await asyncio.sleep(0)
        if self.sent:
            return self.sent.pop()
        self.num_read += 1
        playhead = session_pb2.SessionEvent(session=HANDLE, playhead=session_pb2.Playhead())
        return service_pb2.StreamMotionRequest(events=[playhead] * self.num_events).SerializeToString()


@dataclass
class Slow:
    """A stream each of whose events takes the loop `event_s`, its reader, and a clock that stands still."""

    monkeypatch: pytest.MonkeyPatch
    event_s: float
    num_events: int = 1

    def __post_init__(self) -> None:
        self.now_s, clock = [time.monotonic()], Clock()
        self.monkeypatch.setattr(time, "monotonic", lambda: self.now_s[0])  # the event loop's clock too
        self.line = Line()
        self.loop = LoopTime(0.4, self.now_s[0], Clocks(clock, clock))
        self.peer = Peer(PeerLimits(), self.now_s[0], loop=self.loop)
        self.peer.begin_stream()
        self.stream = Stream(1, self.line.models, peer=self.peer)

        def receive(*_: object) -> None:
            clock.now_s += self.event_s

        self.monkeypatch.setattr(self.stream, "receive", receive)
        self.context = Context(self.num_events)
        reader = StreamReader(self.line.models, "replica")
        self.reading = asyncio.create_task(reader.read(self.stream, cast(StreamContext, self.context)))

    async def go_on(self, rounds: int = 2 * EVENTS_A_TURN) -> int:
        """How many messages have been read after that many iterations of the event loop."""
        for _ in range(rounds):
            await asyncio.sleep(0)
        return self.context.num_read


async def test_work_counts_its_events_and_those_refused() -> None:
    line = Line()
    line.open()
    work = line.stream.work
    with work:
        line.send(2, edit_prompts=session_pb2.EditPrompts(upsert=[motion_pb2.PromptSpan()] * 17))
        line.send(3, close=session_pb2.CloseSession())
        line.stream.receive(
            session_pb2.SessionEvent(session=HANDLE + 1, event_seq=2, close=session_pb2.CloseSession()), 0.0
        )
        assert (work.num_events, work.num_refused) == (3, 2)
    assert [reason for _, reason in line.refusals()] == ["TOO_MANY_PROMPTS", "SESSION_NOT_OPEN"]


async def test_stream_is_not_read_further_until_it_has_paid_for_its_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = Slow(monkeypatch, LONG_S)
    assert await slow.go_on() == 3, "two are a second's worth; the cost of the third is known only afterwards"
    assert (slow.loop.num_held, slow.loop.taken_s) == (1, pytest.approx(3 * LONG_S))
    slow.now_s[0] += 0.4
    assert await slow.go_on() == 3
    slow.now_s[0] += 0.2
    assert await slow.go_on() == 4
    assert slow.loop.num_held == 2
    slow.reading.cancel()


async def test_rest_of_a_message_waits_until_its_first_part_is_paid(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = Slow(monkeypatch, LONG_S / EVENTS_A_TURN, num_events=10 * EVENTS_A_TURN)
    await slow.go_on()
    assert slow.loop.taken_s == pytest.approx(3 * LONG_S), "three of the first message's ten turns"
    slow.now_s[0] += 10.0
    await slow.go_on()
    assert slow.context.num_read == 1
    assert slow.loop.taken_s > 3 * LONG_S
    slow.reading.cancel()


async def test_stream_in_debt_looks_again_before_its_debt_is_paid(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = Slow(monkeypatch, LONG_S)
    for _ in range(99):
        slow.peer.begin_stream()
    assert await slow.go_on() == 3
    assert slow.stream.owed_s(slow.now_s[0]) > 10 * stream_take_overs.LOOK_AGAIN_S, "a hundredth of 0.4 s comes back"
    slow.now_s[0] += stream_take_overs.LOOK_AGAIN_S
    assert await slow.go_on() > 3, "nobody else has taken anything"
    slow.reading.cancel()


async def test_loop_time_is_charged_for_answers_and_not_for_frames() -> None:
    line = Line()
    loop = LoopTime(0.4, time.monotonic(), Clocks(Ticks(), Ticks()))
    stream = Stream(1, line.models, peer=peer_of(loop))
    line.stream = stream
    line.open()
    opened_s = loop.taken_s
    key = SessionKey(1, HANDLE)
    stream.take(Chunk(key, 1, 0, np.zeros((4, 3), np.float32), 4))
    assert loop.taken_s == opened_s
    stream.take(Outcome(key, 2, Code.OK), Outcome(key, 3, Code.OK))
    assert loop.taken_s == pytest.approx(opened_s + 0.002)
    waiting = stream.send_queue.take(1 << 20)
    frames = [each for each in waiting if not isinstance(each, tuple)]
    assert len(frames) == 1
    response_of(frames, stream.work)
    assert loop.taken_s == pytest.approx(opened_s + 0.002)
    response_of(waiting, stream.work)
    assert loop.taken_s == pytest.approx(opened_s + 0.005), "responses for the open and for both events"
