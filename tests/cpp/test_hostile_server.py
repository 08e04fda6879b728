"""The C++ client and a server that breaks the rules of frames, says goodbye, or stops answering."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from motiongen.v1 import service_pb2, session_pb2
from tests.client import test_hostile_server as hostile
from tests.client.fake_server import FakeServer, FakeStream
from tests.cpp.test_client import NOTICES_SILENCE, Character, character

Program = Callable[[str], Path]


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer() as running:
        yield running


def check_motion(walker: Character) -> None:
    """Check that the root moves 5 cm per frame, as the fake server sends it, across all plans."""
    walker.tell("held")
    words = walker.hear("held")
    first, places = int(words[1]), [float(word) for word in words[2:]]
    assert len(places) > 20
    assert [round(place / 0.05) for place in places] == list(range(first, first + len(places)))


def run_on_velocity(server: FakeServer, script: hostile.Script) -> None:
    """Run the script when a velocity comes, on the thread that sends frames, so that none come in between."""

    def refuse(event: session_pb2.SessionEvent) -> str:
        if event.HasField("set_velocity"):
            script(server.stream, server.stream.characters[1])
        return ""

    server.refuse = refuse


@pytest.mark.parametrize(
    "script",
    [
        hostile.gap,
        hostile.replay,
        hostile.replayed_notice,
        hostile.plan_of_the_past,
        hostile.chunk_of_an_older_plan,
        hostile.promise_taken_back,
        hostile.half_a_row,
    ],
    ids=lambda script: script.__name__,
)
def test_invalid_frames_or_plans_end_the_session_and_held_frames_stay_valid(
    program: Program, server: FakeServer, script: hostile.Script
) -> None:
    run_on_velocity(server, script)
    with character(program, server.address) as walker:
        walker.tell("wait 60")
        walker.hear("frame")
        walker.tell("velocity 0 1")
        assert walker.hear("closed")[1] == "PROTOCOL_VIOLATION"
        check_motion(walker)


def test_goodbye_before_the_plan_of_an_edit_loses_no_frame(program: Program, server: FakeServer) -> None:
    def say_goodbye(stream: object, told: object) -> None:
        goodbye = service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING)
        goodbye.grace.FromSeconds(60)
        server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=goodbye))

    run_on_velocity(server, say_goodbye)
    with character(program, server.address) as walker:
        walker.tell("wait 60")
        walker.hear("frame")
        walker.tell("velocity 0 1")
        walker.hear("draining")
        assert walker.hear("edit")[2] == "OK"
        walker.tell("wait 200")
        assert walker.hear("frame")[2] == "OK"
        check_motion(walker)


def test_unknown_update_of_a_later_version_is_ignored(program: Program, server: FakeServer) -> None:
    def say_news(stream: object, told: object) -> None:
        news = session_pb2.SessionUpdate(session=1)
        news.MergeFromString(b"\xc2\x3e\x01x")  # an unknown field
        server.stream.outgoing.put(service_pb2.StreamMotionResponse(updates=[news]))

    run_on_velocity(server, say_news)
    with character(program, server.address) as walker:
        walker.tell("wait 60")
        walker.hear("frame")
        walker.tell("velocity 0 1")
        assert walker.hear("edit")[2] == "OK"
        walker.tell("wait 120")
        assert walker.hear("frame")[2] == "OK"
        check_motion(walker)


def test_late_plan_changes_no_frame_that_was_shown(program: Program, server: FakeServer) -> None:
    def script(event: session_pb2.SessionEvent) -> str:
        if event.HasField("playhead"):
            event.playhead.frame = min(event.playhead.frame, 10)  # so that the server commits few frames
        if event.HasField("set_velocity"):
            server.stream.characters[1].sent_to = 20
            server.stream.announce(1, 20, session_pb2.PLAN_CAUSE_EDIT, (2,))
            server.stream.send_chunk(1, 50)
        return ""

    server.refuse = script
    with character(program, server.address, MOTIONGEN_CLOCK="manual") as walker:
        walker.tell("wait 60")
        walker.hear("frame")
        walker.tell("to 40")
        assert walker.hear("at")[2] == "OK"
        before = walker.place(40)
        walker.tell("velocity 0 1")
        assert walker.hear("edit")[2] == "OK"
        assert walker.place(40) == before
        assert walker.place(41)[0] > before[0], "frames not yet shown are of the new plan"
        walker.tell("stats")
        assert walker.hear("stats")[3] == "1"
        check_motion(walker)


def test_paused_session_closed_by_the_server_reports_the_reason(program: Program, server: FakeServer) -> None:
    with character(program, server.address) as walker:
        walker.tell("wait 20")
        walker.hear("frame")
        walker.tell("pause")
        assert walker.hear("edit")[2] == "OK"
        server.stream.push(1, closed=session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_IDLE))
        assert walker.hear("closed")[1] == "IDLE"
        walker.tell("wait 100000")
        assert walker.hear("frame")[2] == "IDLE", "waiting for a frame that never comes ends with the reason"
        walker.tell("resume")
        assert "IDLE" in " ".join(walker.hear("refused"))
        check_motion(walker)


class DiscardingQueue(queue.Queue[service_pb2.StreamMotionResponse]):
    """Discards what is put into it, except the end."""

    def get(self, block: bool = True, timeout: float | None = None) -> service_pb2.StreamMotionResponse:
        while (response := super().get(block, timeout)) is not None:
            pass
        return response


def test_silent_server_is_reconnected_to_and_held_frames_are_played(program: Program, server: FakeServer) -> None:
    def fall_silent(stream: FakeStream, told: object) -> None:
        waiting = stream.outgoing
        stream.outgoing = DiscardingQueue()
        waiting.put(service_pb2.StreamMotionResponse())  # wakes the writer, which reads the other queue from now on

    run_on_velocity(server, fall_silent)
    with character(program, server.address, **NOTICES_SILENCE) as walker:
        walker.tell("wait 60")
        walker.hear("frame")
        walker.tell("velocity 0 1")
        assert walker.hear("lost")[1] == "UNAVAILABLE"
        server.refuse = lambda event: ""
        _, first, exact = walker.hear("recovered")
        assert int(first) > 60
        assert exact == "0"
        assert walker.hear("edit")[2] == "OK", "the new stream answers what the silent one did not"
        walker.tell(f"wait {int(first) + 40}")
        assert walker.hear("frame")[2] == "OK"
