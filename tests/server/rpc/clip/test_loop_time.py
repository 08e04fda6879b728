"""The event loop time of calls for clips is charged to their peer, and paid before its next call is read."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import grpc
import pytest

from motiongen.v1 import motion_pb2, service_pb2
from motiongen_server.engine.types import Code, Open
from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.rpc import service as service_module
from motiongen_server.rpc.budgets.loop_time import REFUSED_TIMES, UNLIMITED, Clocks, LoopTime
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.peers import Peers
from motiongen_server.rpc.calls.work import begin_work, work_for
from motiongen_server.rpc.clip import clip_service
from motiongen_server.rpc.clip.request import clip_specs
from motiongen_server.rpc.errors.streams import malformed
from motiongen_server.rpc.limits import PeerLimits, ServiceLimits
from tests.contract.local import LocalServer
from tests.server.rpc.budgets.test_loop_time import Clock
from tests.server.rpc.clip.test_calls import clip, generate, hold_up, no_job_is_left, refusal, waypoint
from tests.waiting import LIMIT_S, until_true

WORDS = [motion_pb2.PromptSpan(prompt_id=1, text="walk")]
LITTLE = ServiceLimits(loop_share=1e-6)
"""A debt of more than a microsecond lasts longer than the test."""


@pytest.fixture
def standing() -> Clock:
    """The clock by which work is measured; it stands still unless a test moves it."""
    return Clock()


def metered(server: LocalServer, clock: Clock) -> LoopTime:
    """A server's account of event loop time, measured by that clock."""
    loop = server.service._loop_time
    loop.clocks = Clocks(clock, clock)
    return loop


def taking(clock: Clock, seconds: float, work: Callable[..., Any]) -> Callable[..., Any]:
    def slowly(*given: Any, **named: Any) -> Any:
        clock.now_s += seconds
        return work(*given, **named)

    return slowly


async def test_all_work_on_a_clip_until_the_engine_has_it_is_measured(
    standing: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer() as server:
        loop = metered(server, standing)
        parts = {"clip_request": service_module, "check_extent": clip_service, "num_paths": clip_service,
                 "clip_specs": clip_service, "coding_of": clip_service, "warnings_of": clip_service}  # fmt: skip
        for power, (name, module) in enumerate(parts.items()):
            monkeypatch.setattr(module, name, taking(standing, 2.0**power, getattr(module, name)))
        submit = server.engine.submit
        slow_open = taking(standing, 64.0, submit)
        monkeypatch.setattr(
            server.engine, "submit", lambda event: (slow_open if isinstance(event, Open) else submit)(event)
        )
        release = hold_up(server)
        asking = asyncio.create_task(generate(server, clip(40, prompts=WORDS)))
        await until_true(lambda: loop.taken_s >= 127)
        assert loop.taken_s == 127
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)
        release()


async def test_peer_in_debt_for_a_clip_is_refused_the_next_before_it_is_read(
    standing: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer(service_limits=LITTLE) as server:
        loop = metered(server, standing)
        slow_specs = taking(standing, 1.0, clip_specs)
        monkeypatch.setattr(clip_service, "clip_specs", slow_specs)
        code, info, _ = await refusal(server, clip(60, constraints=[waypoint(60)]))
        assert (code, info.reason) == (grpc.StatusCode.INVALID_ARGUMENT, "CONSTRAINT_OUTSIDE_CLIP")
        assert loop.taken_s == 1.0
        code, info, _ = await refusal(server, clip(60))
        assert (code, info.reason) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_CALLS")
        assert loop.taken_s == 1.0
        assert server.runner.prepared == []
        await until_true(lambda: not loop.num_peers)


async def test_clip_request_with_prompts_is_converted_only_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []
    once = taking(Clock(), 0.0, lambda *given: made.append(given) or clip_specs(*given))
    monkeypatch.setattr(clip_service, "clip_specs", once)
    async with asyncio.timeout(LIMIT_S), LocalServer() as server:
        samples = await generate(server, clip(40, 2, prompts=WORDS, constraints=[waypoint(20)]))
        assert len(samples) == 2
    assert len(made) == 1


async def test_address_has_a_part_of_the_loop_while_its_clip_is_made() -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer() as server:
        loop, release = server.service._loop_time, hold_up(server)
        asking = asyncio.create_task(generate(server, clip(400)))
        await until_true(lambda: server.runner.prepared)
        assert loop.num_peers == 1
        asking.cancel()
        await no_job_is_left(server)
        await until_true(lambda: not loop.num_peers)
        release()


async def test_memory_of_a_clip_request_is_counted_before_the_watch_next_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    unknown = b"\x7a\x80\x80\x08" + b"a" * (1 << 17)
    request = service_pb2.GenerateClipRequest.FromString(clip(400).SerializeToString() + unknown)
    limits = ServiceLimits(max_waiting_bytes=3 << 16, loop_share=UNLIMITED)
    async with asyncio.timeout(LIMIT_S), LocalServer(service_limits=limits) as server:
        monkeypatch.setattr(server.service.watch, "look", lambda now: None)
        release = hold_up(server)
        code, info, _ = await refusal(server, request)
        assert (code, info.reason) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "SLOW_READER")
        await no_job_is_left(server)
        release()


def test_work_that_ends_in_a_refusal_is_charged_several_times(standing: Clock) -> None:
    peer = Peer(PeerLimits(), time.monotonic(), loop=LoopTime(1e-6, time.monotonic(), Clocks(standing, standing)))

    def work(error: Exception | None) -> float:
        before = peer.loop.bucket.owed_s(time.monotonic())
        try:
            with work_for(peer):
                standing.now_s += 1.0
                if error is not None:
                    raise error
        except (EventRefused, StreamRefused, ValueError):
            pass
        return (peer.loop.bucket.owed_s(time.monotonic()) - before) * 1e-6

    of_event, of_call = EventRefused(Code.INVALID_ARGUMENT, "R", "m"), malformed("what")
    for error in (of_event, of_call):
        assert work(error) == pytest.approx(REFUSED_TIMES, abs=1e-3)
    assert work(None) == pytest.approx(1.0, abs=1e-3)
    assert work(ValueError()) == pytest.approx(1.0, abs=1e-3)
    assert peer.loop.taken_s == pytest.approx(4.0)


def test_clips_and_streams_of_different_peers_have_equal_parts(standing: Clock) -> None:
    now = time.monotonic()
    peers = Peers(PeerLimits(), LoopTime(1e-6, now, Clocks(standing, standing)))
    streams, clips = (peers.find(f"ipv4:10.0.0.{host}:1", now) for host in (1, 2))
    streams.begin_stream()
    over = begin_work(clips)
    assert clips.loop_part.rate == streams.loop_part.rate == pytest.approx(0.5e-6)
    with work_for(clips):
        standing.now_s += 1.0
    assert streams.loop_part.ahead_s(time.monotonic()) == 0.0
    with pytest.raises(StreamRefused, match="took more than its share of the server"):
        begin_work(clips)
    assert not clips.is_idle(time.monotonic())
    over()
    streams.end_stream()
    assert clips.loop.num_peers == 0
