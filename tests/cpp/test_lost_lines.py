"""The C++ client and the real service, with the connection between them cut at two hundred moments."""

from __future__ import annotations

import asyncio
import random
from asyncio.subprocess import PIPE
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.contract.local import LocalServer
from tests.e2e.lost_line import FACTS_AS_SERVED, Taken
from tests.e2e.tcp_proxy import TcpProxy
from tests.server.engine.fakes import FRAME, PROMPT
from tests.waiting import LIMIT_S, until_true

NO_TEXT = -1
NUM_CLIENTS, CHARACTERS_EACH, CUTS_EACH = 8, 2, 25


@dataclass
class Played:
    """The edits that one character was sent, and the frames that it has shown.

    edits: (letters of the prompt, first frame, playhead at the answer). shown: of each frame its number and letters.
    """

    recoveries: int = 0
    edits: list[tuple[int, int, int]] = field(default_factory=list)
    shown: list[tuple[int, int]] = field(default_factory=list)


def read(told: str) -> list[Played]:
    """Parse the output of `cut_lines`."""
    played: dict[str, Played] = defaultdict(Played)
    for line in told.splitlines():
        kind, number, *values = line.split()
        match kind:
            case "session":
                played[number].recoveries = int(values[0])
            case "edit":
                letters, frame, heard_at = map(int, values)
                played[number].edits.append((letters, frame, heard_at))
            case "shown":
                frame, *columns = map(int, values)
                assert frame == len(played[number].shown), "each frame is shown once, in order"
                played[number].shown.append((columns[0], columns[1]))
            case _:
                raise AssertionError(line)
    return list(played.values())


def check(played: Played) -> int:
    """Check that each frame has its own number, and the prompt answered last for it. Returns how many had a prompt.

    Frames shown before the answer came are not checked. A frame that no span covers is generated without text: between
    two edits of one prompt, if the first waited and the lead has become shorter since.
    """
    num_checked = num_bare = 0
    for frame, (number, letters) in enumerate(played.shown):
        assert number == frame
        in_force = [each for each in played.edits if each[1] <= frame]
        if in_force and in_force[-1][2] >= frame:
            continue
        if letters == NO_TEXT:
            num_bare += 1
            continue
        assert letters == (in_force[-1][0] if in_force else len("first")), f"frame {frame}"
        num_checked += 1
    assert num_checked > len(played.shown) // 10  # delays grow if connections are cut again soon
    assert num_bare < len(played.shown) // 20
    return num_checked


async def test_two_hundred_lost_connections_lose_no_frame_or_event(
    program: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, taken = random.Random(11), Taken()

    async def one_client(server: LocalServer, seed: int) -> list[Played]:
        async with TcpProxy(server.address) as proxy:

            def budget() -> int | None:
                return rng.randrange(1000, 20000) if proxy.num_cuts < CUTS_EACH else None

            words = [str(CHARACTERS_EACH), str(seed), str(FRAME), str(PROMPT)]
            process = await asyncio.create_subprocess_exec(
                program("cut_lines"), proxy.address, *words, stdin=PIPE, stdout=PIPE
            )
            try:
                assert process.stdout is not None
                assert await process.stdout.readline() == b"playing\n"
                proxy.budget = budget
                proxy.cut()
                await until_true(lambda: proxy.num_cuts >= CUTS_EACH)
                told, _ = await process.communicate(b"enough\n")
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
            assert process.returncode == 0
            return read(told.decode())

    async with asyncio.timeout(LIMIT_S), LocalServer(facts=FACTS_AS_SERVED) as server:
        taken.watch(server, monkeypatch)
        clients = await asyncio.gather(*(one_client(server, seed) for seed in range(NUM_CLIENTS)))
        assert len(taken.numbers) == NUM_CLIENTS * CHARACTERS_EACH, "no session was reopened"
        for numbers in taken.numbers.values():
            assert numbers == list(range(1, len(numbers) + 1)), "every event is accepted once, in order"
    sessions = [session for client in clients for session in client]
    assert min(len(session.edits) for session in sessions) > 3
    num_checked = sum(check(session) for session in sessions)
    assert num_checked > sum(len(session.shown) for session in sessions) // 3
    recoveries = sum(session.recoveries for session in sessions)
    assert recoveries > NUM_CLIENTS * CUTS_EACH // 2
