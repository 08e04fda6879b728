"""The blocking client: sessions without asyncio."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue

import numpy as np
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import Edit as AsynchronousEdit
from motiongen_client import EventRefused, InvalidInput, ServerUnavailable, SessionEnded, StreamLost, Waypoint
from motiongen_client import MotionClient as AsynchronousClient
from motiongen_client import Session as Asynchronous
from motiongen_client import Stream as AsynchronousStream
from motiongen_client.blocking import Edit, MotionClient, Stream
from motiongen_client.blocking_session import Session as Blocking
from tests.client.fake_server import FakeServer
from tests.waiting import until


@pytest.fixture
def client(server: FakeServer) -> Iterator[MotionClient]:
    with MotionClient(server.address) as connected:
        yield connected


def test_frames_prompts_and_waypoints(client: MotionClient) -> None:
    session = client.open("a person walks", keep_s=None)
    edit = None
    for frame in session.frames(seconds=1):
        if frame.index == 20:
            edit = session.set_prompt("a person runs")
            session.add_waypoint(0, 3, frame=session.frame_in(0.9))
    assert edit is not None
    assert edit.wait().effective_frame is not None
    assert edit.latency_s is not None
    assert len(session.motion(end_frame=100)) == 100  # a late reader is given several frames at once
    assert session.stats.plans >= 3
    assert session.close().reason == "client"


def test_calls_of_a_client_that_was_never_connected_raise_stream_lost() -> None:
    client = MotionClient("localhost:1")
    for call in (client.open, client.stream, lambda: client.generate_clip("a person walks", num_frames=8)):
        with pytest.raises(StreamLost, match="never connected"):
            call()
    client.close()


def test_connected_client_has_one_thread_and_can_connect_again_after_closing(server: FakeServer) -> None:
    def threads() -> int:
        return sum(thread.name == "motiongen-client" for thread in threading.enumerate())

    before, client = threads(), MotionClient(server.address)
    for _ in range(2):
        with client.connect():
            assert threads() == before + 1
        assert threads() == before


def test_threads_that_connect_one_client_at_once_share_its_connection(server: FakeServer) -> None:
    client, ready = MotionClient(server.address), threading.Barrier(8)

    def open_one() -> str:
        ready.wait()
        return client.connect().open("a person walks").opened.session_id

    with ThreadPoolExecutor(8) as threads:
        opened = [threads.submit(open_one) for _ in range(8)]
        assert len({each.result() for each in opened}) == 8
    assert sum(thread.name == "motiongen-client" for thread in threading.enumerate()) == 1
    assert client.is_connected
    client.close()
    assert not client.is_connected
    assert len(server.streams) == 1


def test_blocking_api_has_all_methods_that_applications_use() -> None:
    def methods(kind: type) -> set[str]:
        return {name for name in dir(kind) if not name.startswith("_")}

    for_streams = {"abandon", "begin", "fail", "hear", "interrupt", "is_over", "is_reporting", "reattach", "report"}
    only_there = for_streams | {"glance", "is_same", "is_waiting", "move", "wait_for_room"}
    assert methods(Asynchronous) - methods(Blocking) == only_there
    assert methods(AsynchronousClient) - methods(MotionClient) == set()
    for_sessions = {"note_first_frame", "settle", "take_the_place_of", "when_accepted", "when_refused", "result"}
    assert methods(AsynchronousEdit) - methods(Edit) == for_sessions
    for_sessions = {"adopt", "ask_catalog", "call_number", "check", "move_elsewhere", "recovers", "release", "send"}
    only_there = for_sessions | {"report_soon", "start", "sessions"}  # an application knows the sessions that it opened
    assert methods(AsynchronousStream) - methods(Stream) == only_there


def test_callbacks_are_called_on_the_background_thread(client: MotionClient, server: FakeServer) -> None:
    session, told = client.open("a person walks"), SimpleQueue[tuple[str, object]]()

    def keep(name: str) -> Callable[[object], None]:
        return lambda news: told.put((threading.current_thread().name, getattr(news, name, news)))

    session.on_service_level, session.on_constraint_reached = keep("tier"), keep("constraint_id")
    session.on_durability, session.on_reopened = keep(""), keep("frame")
    level = session_pb2.ServiceLevel(tier=session_pb2.SERVICE_TIER_HOLD, denoise_steps=1)
    server.stream.push(1, service_level=level)
    server.stream.push(1, constraint_reached=session_pb2.ConstraintReached(constraint_id=7))
    server.stream.push(1, durability=session_pb2.SessionDurability(is_kept=True))
    assert [told.get() for _ in range(3)] == [("motiongen-client", each) for each in ("hold", 7, True)]
    server.stream.end()
    heard = [told.get()[1] for _ in range(3)]
    assert heard == [False, session.reopenings[0].frame, "full"]
    session.on_service_level = None
    assert session.on_service_level is None


def test_stream_carries_several_sessions(client: MotionClient) -> None:
    with client.stream() as stream, stream.open("one") as one, stream.open("two") as two:
        assert [frame.index for frame in one.frames(seconds=0.1)] == list(range(10))
        assert [frame.index for frame in two.frames(seconds=0.1, realtime=False)] == list(range(10))
        while two.poll() is None:
            pass
        constraints = two.set_constraints([Waypoint(90, 0, 1)])
        assert constraints.wait().effective_frame is not None
        assert two.pause().wait().effective_frame is None
    assert one.end is not None


def test_poll_calls_the_event_loop_once_per_frame_not_per_call(
    client: MotionClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = client.open("a person walks")
    while session.poll() is None:
        pass
    session.pause().wait()
    now_s = [100.0]
    monkeypatch.setattr(session._inner, "_clock", lambda: now_s[0])
    session.resume().wait()
    asked = []
    call = session._loop.call
    monkeypatch.setattr(session._loop, "call", lambda function: asked.append(function) or call(function))
    shown = []
    for tick in range(200):  # 10 for each frame of the server's 100 a second
        now_s[0] = 100.0 + tick / 1000
        frame = session.poll()
        assert frame is not None
        shown.append(frame.index)
    assert shown == sorted(shown)
    assert len(set(shown)) >= 19
    assert len(asked) < 80, "once for each frame and for each update that came"
    monkeypatch.undo()
    assert session.close().reason == "client"
    assert session.poll() is not None


def test_sample_interpolates_between_frames_at_any_time_scale(
    client: MotionClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = client.open("a person walks")
    while session.poll() is None:
        pass
    session.pause().wait()
    playback = session._inner.playback
    while playback.buffered_to < playback.playhead + 20:
        pass
    now_s = [100.0]
    monkeypatch.setattr(session._inner, "_clock", lambda: now_s[0])
    session.resume().wait()
    places, shares = [], []
    for tick in range(40):  # 4 for each frame of the server's 100 a second
        now_s[0] = 100.0 + tick / 400
        frame = session.sample()
        assert frame is not None
        places.append(frame.root_translation_m[2])
        shares.append(round(frame.share, 3))
    assert np.diff(places) == pytest.approx(0.05 / 4, abs=1e-5)  # the root goes 0.05 m a frame
    assert len(set(shares)) >= 4, "most samples are between frames"
    session.set_time_scale(0.5)
    session.sample()
    now_s[0] += 1 / 100
    slower = session.sample()
    assert slower is not None
    assert slower.root_translation_m[2] - places[-1] == pytest.approx(0.05 / 2, abs=1e-5)


def test_leaving_frames_early_leaves_the_session_usable(client: MotionClient) -> None:
    session = client.open("a person walks")
    for frame in session.frames():
        if frame.index == 5:
            break
    assert next(iter(session.frames())).index == 6


def test_frames_generator_used_after_its_client_was_closed_raises_session_ended(server: FakeServer) -> None:
    with MotionClient(server.address) as client:
        frames = client.open("a person walks").frames()
        assert next(frames).index == 0
    with pytest.raises(SessionEnded, match="client was closed"):
        next(frames)
    frames.close()


@pytest.mark.parametrize("how", ["closed", "collected"])
def test_frames_generator_may_be_closed_or_collected_after_its_client(server: FakeServer, how: str) -> None:
    with MotionClient(server.address) as client:
        frames = client.open("a person walks").frames()
        assert next(frames).index == 0
    if how == "closed":
        frames.close()
    del frames
    gc.collect()  # warnings are errors, also those about exceptions that cannot be raised


def test_closing_the_client_closes_its_streams_and_sessions(server: FakeServer) -> None:
    with MotionClient(server.address) as client, client.stream() as stream, stream.open("one") as one:
        client.close()
        assert one.end is not None
        with pytest.raises(SessionEnded, match="client was closed"):
            one.poll()


def test_motion_and_answers_stay_readable_after_the_client_was_closed(server: FakeServer) -> None:
    with MotionClient(server.address) as client:
        session = client.open("a person walks", keep_s=None)
        for _ in session.frames(seconds=0.2):
            pass
        edit = session.set_prompt("a person runs")
        outcome = edit.wait()
        end = session.close()
    shown_to = session.motion().first_frame + len(session.motion())
    assert session.frame_in(0) == shown_to - 1 >= 19
    assert session.stats.plans >= 2
    assert session.close() == end
    assert edit.wait() == outcome
    with pytest.raises(SessionEnded, match="client was closed"):
        session.set_prompt("a person sits")
    with pytest.raises(InvalidInput, match="frames"):
        session.motion(0, 10**6)


def test_refused_edit_raises_event_refused(client: MotionClient, server: FakeServer) -> None:
    server.refuse = lambda event: "TOO_MANY" if event.WhichOneof("event") == "edit_prompts" else ""
    session = client.open("a person walks")
    edit = session.set_prompt("one more")
    with pytest.raises(EventRefused, match="TOO_MANY"):
        edit.wait()
    client.close()
    assert edit.done()
    assert edit.outcome is None
    with pytest.raises(EventRefused, match="TOO_MANY"):
        edit.wait()


def test_edit_without_an_answer_is_not_done_until_the_client_is_closed(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = client.open("a person walks")
    monkeypatch.setattr(server.stream, "replan", lambda event: None)
    edit = session.set_prompt("one more")
    assert not edit.done()
    client.close()
    assert edit.done()


def test_stream_tells_what_is_known_of_its_connection(client: MotionClient, server: FakeServer) -> None:
    stream = client.stream()
    with stream:
        stream.ready()
        assert (stream.is_connected, stream.is_over, stream.draining, stream.replica_id) == (
            True,
            False,
            False,
            "first",
        )
        until(lambda: stream.round_trip_s is not None)
        server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=service_pb2.Goodbye()))
        until(lambda: stream.draining)
    assert (stream.is_connected, stream.is_over) == (False, True)
    with pytest.raises(StreamLost, match="closed here"):
        stream.ready()


def test_failed_connect_leaves_no_thread() -> None:
    with pytest.raises(ServerUnavailable):
        MotionClient("127.0.0.1:1", connect_timeout_s=0.2).connect()
    assert "motiongen-client" not in {thread.name for thread in threading.enumerate()}
