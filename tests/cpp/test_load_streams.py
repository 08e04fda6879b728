"""motiongen-load and a fake server: pings, values of a later version, and calls that do not end."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from tests.client.fake_server import FakeServer, FakeStream
from tests.waiting import until

Program = Callable[[str], Path]
Message = dict[str, Any]
PONG_LATE = 2  # in pings: more than two seconds, too many nanoseconds for 32 bits


class Play:
    """One process of a load."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def say(self, message: Message) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(message) + "\n")
        self._process.stdin.flush()

    def hear(self, kind: str) -> Any:
        """The content of the next message of a kind."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            message: Message = json.loads(line)
            if kind in message:
                return message[kind]
        raise AssertionError(f"it ended without printing {kind!r}")

    def end(self) -> None:
        assert self._process.wait() == 0


@contextmanager
def playing(program: Program, server: FakeServer, **more: object) -> Iterator[Play]:
    """A load on the server, once its program is ready."""
    message: Message = {"address": server.address, "num_processes": 1, "num_streams": 1, "max_request_bytes": 65536}
    message |= {"frame_rate": 20, "patch_frames": 4, "report_hz": 4, "measure_to_s": 3600, "end_s": 0.5}
    message |= {"groups": [{"name": "g", "prompts": ["walk"]}], "jitter_s": [0]}
    pipe = subprocess.PIPE
    with subprocess.Popen([program("motiongen-load")], stdin=pipe, stdout=pipe, text=True) as process:
        try:
            play = Play(process)
            play.say(message | more)
            play.hear("ready")
            yield play
        finally:
            process.kill()


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer(frame_rate=20) as running:
        yield running


def go(play: Play) -> None:
    play.say({"start_at_s": time.monotonic()})


def num_recorded(book: Message, what: str) -> int:
    return sum(int(count) for each in book["latencies"] if each["what"] == what for count in each["count"])


def test_hello_is_not_counted_as_a_write_that_waited(program: Program, server: FakeServer) -> None:
    with playing(program, server) as play:
        go(play)
        book = play.hear("book")
        play.end()
    assert num_recorded(book, "write_wait") == len(server.stream.pings) > 0, "nothing but pings was sent"


def test_round_trip_of_seconds_is_reported_without_overflow(program: Program, server: FakeServer) -> None:
    with playing(program, server, end_s=3600) as play:
        stream = server.stream
        stream.answers_pings = False
        go(play)
        until(lambda: len(stream.pings) >= PONG_LATE)
        pong = service_pb2.Pong(client_time_ns=stream.pings[0].client_time_ns)
        stream.outgoing.put(service_pb2.StreamMotionResponse(pong=pong))
        until(lambda: any(ping.HasField("round_trip") for ping in stream.pings))
        told = next(ping.round_trip for ping in stream.pings if ping.HasField("round_trip"))
        assert told.seconds >= 1
        assert 0 <= told.nanos < 1_000_000_000


def test_unknown_enum_values_are_counted_by_their_number(program: Program, server: FakeServer) -> None:
    with playing(program, server, end_s=2, characters=[{"open_s": 0, "seed": "7"}, {"open_s": 0, "seed": "8"}]) as play:
        go(play)
        stream = server.stream
        until(lambda: len(stream.characters) == 2)
        level = session_pb2.ServiceLevel(denoise_steps=3)
        level.tier = 9  # type: ignore[assignment]  # of a later version
        closed = session_pb2.SessionClosed()
        closed.reason = 99  # type: ignore[assignment]  # of a later version
        stream.push(1, service_level=level)
        stream.push(1, closed=closed)
        counts = play.hear("book")["counts"]
    assert counts["service level: 9, 3 steps"] == "1"
    assert counts["sessions_lost: 99"] == "1"


class NeverEnding(FakeServer):
    """Says hello, and ends no call until let_go is set."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[grpc.ServicerContext] = []
        self.let_go = threading.Event()

    def StreamMotion(
        self, request_iterator: Iterator[service_pb2.StreamMotionRequest], context: grpc.ServicerContext
    ) -> Iterator[service_pb2.StreamMotionResponse]:
        self.calls.append(context)
        stream = FakeStream(self.replica_id)
        yield service_pb2.StreamMotionResponse(hello=service_pb2.ServerHello(replica_id=stream.replica_id))
        while not self.let_go.wait(0.05) and context.is_active():
            pass


def test_report_does_not_wait_for_a_server_that_does_not_end_its_calls(program: Program) -> None:
    with NeverEnding() as server, playing(program, server, num_streams=3) as play:
        go(play)
        book = play.hear("book")
        assert book["streams"] == 3
        assert [call.is_active() for call in server.calls] == [True] * 3
        server.let_go.set()
        play.end()


def test_failure_does_not_wait_for_a_server_that_does_not_end_its_calls(program: Program) -> None:
    with NeverEnding() as server, playing(program, server, num_streams=3) as play:
        play.say({"start_at_s": "soon"})
        assert "no moment to start at" in play.hear("failed")
        assert [call.is_active() for call in server.calls] == [True] * 3
        server.let_go.set()
