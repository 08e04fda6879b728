"""Connections that are cut at any moment lose nothing.

The fake runner's frames contain what they were made from, so that every frame can be compared with every answer.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable

import pytest

from motiongen_client import (
    Edit,
    MotionClient,
    Playback,
    Session,
)
from tests.contract.local import LocalServer
from tests.e2e.lost_line import LOOKAHEAD, Received, Taken, a_server
from tests.e2e.tcp_proxy import TcpProxy
from tests.server.engine.fakes import FRAME, PROMPT
from tests.waiting import LIMIT_S, until_true

pytestmark = pytest.mark.usefixtures("short_delays")


NUM_CLIENTS, CUTS_EACH = 8, 25


class Given:
    """A prompt that was given to a session. length: of its text. heard_at: the playhead when its answer came."""

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
    """Play in real time, and record which frames were shown."""
    async for frame in session.frames():
        frames.append(frame.index)


async def direct(session: Session, rng: random.Random, is_over: Callable[[], bool], edits: list[Given]) -> None:
    """Give one prompt after another, each of another length; some are waited for, some not.

    The last is given when no connection is cut any more, so that its answer arrives.
    """
    was_over = False
    while not was_over:
        was_over = is_over()
        length = len(edits) + 1
        edit = session.set_prompt("x" * length)
        edits.append(Given(session, length, edit))
        if was_over or rng.random() < 0.7:
            await edit
        else:
            shown = session.playback.playhead
            await until_true(lambda shown=shown: session.playback.playhead > shown)
    await asyncio.gather(*(_answer(each.edit) for each in edits))


async def _answer(edit: Edit) -> None:
    await edit


def may_show(edits: list[Given], first_length: int, frame: int) -> list[int]:
    """Lengths of the prompts that a frame may show: the last one in effect at it, and those before.

    An earlier one only if the answers of all later ones came when the frame had been shown already.
    """
    lengths = []
    for each in reversed([each for each in edits if each.effective_frame <= frame]):
        lengths.append(each.length)
        if each.heard_at < frame:
            return lengths
    return [*lengths, first_length]


def check_motion(book: Received, edits: list[Given], first_length: int) -> None:
    """Check that no frame is missing, that each shows a prompt allowed for it, and the last one the newest prompt."""
    assert book.changed == []
    frames = sorted(book.rows)
    assert frames == list(range(len(frames)))
    for frame in frames:
        assert book.rows[frame][FRAME] == frame
        assert book.rows[frame][PROMPT] in may_show(edits, first_length, frame), f"frame {frame}"
    assert may_show(edits, first_length, frames[-1]) == [edits[-1].length]


async def test_connections_cut_at_two_hundred_moments_lose_nothing(
    received: dict[Playback, Received], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, taken = random.Random(11), Taken()

    async def one_client(server: LocalServer) -> int:
        def budget() -> int | None:  # counts cuts: a connection that the client has given up before is not one
            return rng.randrange(1000, 20000) if proxy.num_cuts < CUTS_EACH else None

        async with TcpProxy(server.address) as proxy, MotionClient(proxy.address) as client:
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
                last = max(max(each.effective_frame, each.heard_at) for each in of)
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
        assert len(taken.numbers) == 2 * NUM_CLIENTS, "a session was reopened"
        for numbers in taken.numbers.values():
            assert numbers == list(range(1, len(numbers) + 1)), "every event arrives once, in order"
        assert sum(resumes) > NUM_CLIENTS * CUTS_EACH // 2
        assert server.service.num_parked == 0
