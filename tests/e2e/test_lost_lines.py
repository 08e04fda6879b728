"""The Python client and the real service with the line between them cut, silenced and moved elsewhere.

The frames of the fake runner say what they were made of, so that every frame can be held against every answer.
"""

from __future__ import annotations

import asyncio
import random
from collections import defaultdict
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from motiongen_client import (
    Edit,
    LinePolicy,
    MotionClient,
    Playback,
    Session,
    SessionOptions,
    StreamLost,
    backoff,
    calls,
)
from motiongen_server.engine.types import ChannelBlock, Event, Playhead, Resume
from motiongen_server.rpc.limits import Limits
from tests.contract.local import LocalServer
from tests.e2e.tcp_proxy import TcpProxy
from tests.server.engine.fakes import CONSTRAINTS, FACTS, FRAME, PROMPT, SEED
from tests.waiting import until_true

LIMIT_S = 120.0
FACTS_AS_SERVED = replace(
    FACTS,
    fps=100,  # so that little time is a lot of motion
    rig=replace(
        FACTS.rig,
        blocks=(
            ChannelBlock("root_translation_m", 3),
            ChannelBlock("joint_rotation_quat_wxyz", 4),
            ChannelBlock("foot_contact", 4),
            ChannelBlock("rest", 1),
        ),
    ),
)
LOOKAHEAD = SessionOptions(lookahead_frames=80)


@pytest.fixture(autouse=True)
def short_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Delays that grow are the business of the tests of `Backoff`."""
    monkeypatch.setattr(backoff, "LONGEST_DELAY_S", 0.1)
    monkeypatch.setattr(calls, "LAG_S", 0.05)


def a_server(**limits: float) -> LocalServer:
    return LocalServer(Limits(**limits), facts=FACTS_AS_SERVED)  # type: ignore[arg-type]


@asynccontextmanager
async def proxied(
    server: LocalServer, policy: LinePolicy | None = None, budget: Callable[[], int | None] = lambda: None
) -> AsyncIterator[tuple[TcpProxy, MotionClient]]:
    port = int(server.address.rpartition(":")[2])
    async with TcpProxy(port, budget) as proxy, MotionClient(proxy.address, policy=policy or LinePolicy()) as client:
        yield proxy, client


@dataclass
class Received:
    """What one playback was given: the last row of each frame, whatever replaced it."""

    rows: dict[int, np.ndarray] = field(default_factory=dict)
    changed: list[int] = field(default_factory=list)


@pytest.fixture
def received(monkeypatch: pytest.MonkeyPatch) -> dict[Playback, Received]:
    """By playback; committed frames that came again otherwise are noted."""
    heard: dict[Playback, Received] = defaultdict(Received)
    add_chunk = Playback.add_chunk

    def noting(self: Playback, plan: int, first_frame: int, rows: np.ndarray, committed_to: int) -> None:
        promised, book = self.committed_to, heard[self]
        add_chunk(self, plan, first_frame, rows, committed_to)
        for frame, row in enumerate(rows, first_frame):
            if frame < promised and frame in book.rows and not np.array_equal(book.rows[frame], row):
                book.changed.append(frame)
            book.rows[frame] = row

    monkeypatch.setattr(Playback, "add_chunk", noting)
    return heard


@dataclass
class Taken:
    """The numbers of the events that the engine was given, by session; playheads and resumes left out."""

    numbers: dict[object, list[int]] = field(default_factory=lambda: defaultdict(list))

    def watch(self, server: LocalServer, monkeypatch: pytest.MonkeyPatch) -> None:
        submit = server.engine.submit

        def noting(event: Event) -> object:
            if not isinstance(event, Playhead | Resume):
                self.numbers[event.session].append(event.event_seq)
            return submit(event)

        monkeypatch.setattr(server.engine, "submit", noting)


class Given:
    """A prompt of some length that was given to a session. heard_at: the playhead when its answer came."""

    def __init__(self, session: Session, length: int, edit: Edit) -> None:
        self.length = length
        self.edit = edit
        self.heard_at = -1
        edit.when_accepted(lambda: setattr(self, "heard_at", session.playback.playhead))

    @property
    def effective_frame(self) -> int:
        assert self.edit.outcome is not None
        assert self.edit.outcome.effective_frame is not None
        return self.edit.outcome.effective_frame


async def shown(session: Session, frames: list[int]) -> None:
    """Play in real time, and note which frames were shown."""
    async for frame in session.frames():
        frames.append(frame.index)


async def direct(session: Session, rng: random.Random, is_over: Callable[[], bool], edits: list[Given]) -> None:
    """Give one prompt after another, each of another length; some are waited for, some not."""
    length = 0
    while not is_over():
        length += 1
        edit = session.set_prompt("x" * length)
        edits.append(Given(session, length, edit))
        if rng.random() < 0.7:
            await edit
        else:
            shown = session.playback.playhead
            await until_true(lambda shown=shown: session.playback.playhead > shown)
    await asyncio.gather(*(_answer(each.edit) for each in edits))


async def _answer(edit: Edit) -> None:
    await edit


def check_motion(book: Received, edits: list[Given], first_length: int) -> None:
    """Every frame is there, and shows the prompt that was answered last for it.

    What was shown while the line was lost, before an answer came that says otherwise, shows what it showed.
    """
    assert book.changed == []
    frames, num_checked = sorted(book.rows), 0
    assert frames == list(range(len(frames)))
    for frame in frames:
        assert book.rows[frame][FRAME] == frame
        in_force = [each for each in edits if each.effective_frame <= frame]
        if in_force and in_force[-1].heard_at >= frame:
            continue
        expected = in_force[-1].length if in_force else first_length
        assert book.rows[frame][PROMPT] == expected, f"frame {frame}"
        num_checked += 1
    assert num_checked > len(frames) // 2


NUM_CLIENTS, CUTS_EACH = 8, 25


async def test_lines_that_are_cut_at_two_hundred_moments_lose_nothing(
    received: dict[Playback, Received], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, taken = random.Random(11), Taken()

    async def one_client(server: LocalServer) -> int:
        left = CUTS_EACH

        def budget() -> int | None:
            nonlocal left
            left -= 1
            return rng.randrange(1000, 20000) if left >= 0 else None

        proxy_port = int(server.address.rpartition(":")[2])
        async with TcpProxy(proxy_port) as proxy, MotionClient(proxy.address) as client:
            proxy._budget = budget
            sessions = [await client.open("first", options=LOOKAHEAD) for _ in range(2)]
            proxy.budget = budget
            proxy.cut()
            frames: list[list[int]] = [[], []]
            edits: list[list[Given]] = [[], []]
            playing = [asyncio.create_task(shown(*each)) for each in zip(sessions, frames, strict=True)]

            def is_over() -> bool:
                return proxy.num_cuts >= CUTS_EACH

            await asyncio.gather(
                *(direct(session, rng, is_over, of) for session, of in zip(sessions, edits, strict=True))
            )
            for session, of in zip(sessions, edits, strict=True):
                last = max(each.effective_frame for each in of)
                await until_true(lambda session=session, last=last: session.playback.playhead > last)
                await session.close()
            await asyncio.gather(*playing)
            for session, of, seen in zip(sessions, edits, frames, strict=True):
                assert seen == list(range(len(seen))), "each frame is shown once, in order"
                assert session.reopenings == ()
                check_motion(received[session.playback], of, len("first"))
            return sum(session.stats.resumes for session in sessions)

    async with asyncio.timeout(LIMIT_S), a_server() as server:
        taken.watch(server, monkeypatch)
        resumes = await asyncio.gather(*(one_client(server) for _ in range(NUM_CLIENTS)))
        assert len(taken.numbers) == 2 * NUM_CLIENTS, "no session was opened anew"
        for numbers in taken.numbers.values():
            assert numbers == list(range(1, len(numbers) + 1)), "every event is taken once, in order"
        assert sum(resumes) > NUM_CLIENTS * CUTS_EACH // 2
        assert server.service.num_parked == 0


async def played(session: Session, frames: int) -> list[int]:
    """Take so many frames as fast as they come."""
    seen: list[int] = []
    async for frame in session.frames(realtime=False):
        seen.append(frame.index)
        if len(seen) == frames:
            break
    return seen


def check_history(server: LocalServer, *frames: int) -> None:
    """The server's sessions were opened anew with histories that end just before these frames of ours.

    The fake runner notes as a breach that histories are not the frames which a session made itself.
    """
    of_histories = [breach for breach in server.runner.breaches if "history" in breach]
    assert {f"the history before 0 ends at {frame - 1}" for frame in frames} <= set(of_histories)
    server.runner.breaches = [breach for breach in server.runner.breaches if breach not in of_histories]


async def test_after_its_grace_a_session_is_opened_anew_and_goes_on_from_what_was_held(
    received: dict[Playback, Received],
) -> None:
    async with asyncio.timeout(LIMIT_S), a_server(resume_grace_s=0.05) as server, proxied(server) as (proxy, client):
        session = await client.open("first", options=SessionOptions(lookahead_frames=80, seed=5))
        await session.set_prompt("second one")
        session.add_waypoint(1, 2, frame=5000)
        assert await played(session, 60) == list(range(60))
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not server.engine.num_sessions)
        waiting = session.set_prompt("third, while away")
        told: list[object] = []
        session.on_reopened = told.append
        proxy.is_shut = False
        outcome = await waiting
        (reopened,) = session.reopenings
        assert told == [reopened]
        assert "SESSION_NOT_KEPT" in reopened.reason
        assert outcome.effective_frame is not None
        assert outcome.effective_frame >= reopened.frame
        rest = await played(session, 200)
        assert rest == list(range(60, 260)), "the application's frames go on"
        rows = received[session.playback].rows
        assert rows[reopened.frame][FRAME] == 0, "which is the new session's first"
        assert rows[reopened.frame][SEED] == 5
        assert rows[outcome.effective_frame + 1][PROMPT] == len("third, while away")
        assert rows[outcome.effective_frame - 1][PROMPT] == len("second one")
        assert rows[259][CONSTRAINTS] == 0, "a constraint this far ahead is not seen yet"
        assert session.stats.reopenings == 1
        assert (await session.close()).reason == "client"
        check_history(server, reopened.frame)


async def test_another_server_goes_on_with_the_sessions_of_one_that_was_killed() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server() as other, a_server() as server, proxied(server) as (proxy, client),
    ):  # fmt: skip
        sessions = [await client.open("a person walks", options=LOOKAHEAD) for _ in range(3)]
        for session in sessions:
            await played(session, 50)
        proxy.is_shut = True
        proxy.cut()
        proxy.port = int(other.address.rpartition(":")[2])
        proxy.is_shut = False
        for session in sessions:
            assert await played(session, 150) == list(range(50, 200))
            assert len(session.reopenings) == 1
        assert other.engine.num_sessions == 3
        assert (await client.open("one more")).reopenings == ()
        check_history(other, *(session.reopenings[0].frame for session in sessions))


async def test_a_server_that_drains_is_left_for_another() -> None:
    async with (
        asyncio.timeout(LIMIT_S), a_server() as other, a_server() as server, proxied(server) as (proxy, client),
    ):  # fmt: skip
        session = await client.open("a person walks", options=LOOKAHEAD)
        await played(session, 50)
        proxy.port = int(other.address.rpartition(":")[2])
        server.service.goodbye(1.0)
        opening = asyncio.create_task(client.open("while it drains"))
        await asyncio.to_thread(lambda: None)
        server.service.close_all()
        assert await played(session, 100) == list(range(50, 150))
        assert "drained" in session.reopenings[0].reason
        assert await played(await opening, 10) == list(range(10))
        assert other.engine.num_sessions == 2
        check_history(other, session.reopenings[0].frame)


async def test_a_line_that_falls_silent_is_noticed_and_the_session_resumed() -> None:
    policy = LinePolicy(ping_s=0.2, pong_timeout_s=0.2, hello_timeout_s=1.0)
    async with asyncio.timeout(LIMIT_S), a_server() as server, proxied(server, policy) as (proxy, client):
        session = await client.open("a person walks", options=LOOKAHEAD)
        await played(session, 50)
        proxy.is_silent = True
        await until_true(lambda: not client.is_connected)
        proxy.is_silent = False
        assert await played(session, 100) == list(range(50, 150))
        assert (session.stats.resumes, session.reopenings) == (1, ())
        assert server.engine.num_sessions == 1


async def test_a_client_that_shall_not_recover_fails_its_sessions_and_can_open_others() -> None:
    policy = LinePolicy(recover_s=0)
    async with asyncio.timeout(LIMIT_S), a_server() as server, proxied(server, policy) as (proxy, client):
        session = await client.open("a person walks")
        proxy.cut()
        with pytest.raises(StreamLost):
            await played(session, 1000)
        other = await client.open("another")
        assert await played(other, 10) == list(range(10))


async def test_a_session_that_is_closed_while_the_line_is_lost_is_over_here_and_later_there() -> None:
    async with asyncio.timeout(LIMIT_S), a_server(resume_grace_s=0.2) as server, proxied(server) as (proxy, client):
        session, other = await client.open("one"), await client.open("two")
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not client.is_connected)
        assert (await session.close()).reason == "client"
        proxy.is_shut = False
        assert await played(other, 10) == list(range(10))
        await until_true(lambda: server.engine.num_sessions == 1)


async def test_a_paused_session_is_paused_when_it_comes_back() -> None:
    async with asyncio.timeout(LIMIT_S), a_server(resume_grace_s=0.05) as server, proxied(server) as (proxy, client):
        session = await client.open("one", options=LOOKAHEAD)
        await played(session, 10)
        await session.pause()
        proxy.is_shut = True
        proxy.cut()
        await until_true(lambda: not server.engine.num_sessions)
        proxy.is_shut = False
        await until_true(lambda: session.reopenings)
        assert (await session.resume()).event_seq == 3, "after its opening, and the pause that it was told again"
        assert len(await played(session, 100)) == 100
        check_history(server, session.reopenings[0].frame)


async def test_a_stream_without_sessions_is_connected_again_when_there_is_one_to_open() -> None:
    async with asyncio.timeout(LIMIT_S), a_server() as server, proxied(server) as (proxy, client):
        await (await client.open("one")).close()
        proxy.cut()
        await until_true(lambda: not client.is_connected)
        await until_true(lambda: not server.service.num_streams)
        assert await played(await client.open("another"), 10) == list(range(10))
        assert server.engine.num_sessions == 1
