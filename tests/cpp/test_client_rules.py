"""The C++ client follows the protocol in all that it sends: a relay between it and a server checks every message."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from tests.conftest import LiveServer
from tests.contract.rules_relay import RulesRelay
from tests.cpp.proxy import BlockingLine
from tests.cpp.test_client import Character, character
from tests.waiting import LIMIT_S

Program = Callable[[str], Path]
EDITS = (
    "prompt a person runs forward",
    "schedule 200 260 a person waves",
    "replace_prompt 2 210 250 a person jumps",
    "remove_prompt 2",
    "waypoint 300 1 2",
    "go 2 4",
    "replace_target id=1 waypoint frame=310 x=1 z=2",
    "remove_target 1",
    "remove_target 77",
    "clear_targets",
    "velocity 0 1 seconds=2",
    "pause",
    "resume",
    "options steps=2",
    "teleport 3 3",
    "seek 36",
)


def edit_in_every_way(walker: Character) -> None:
    """Make all edits, waiting for each answer, and then all of them again without waiting."""
    for line in EDITS:
        walker.tell(line)
        walker.hear("edit")
    for line in EDITS:
        walker.tell(line)
    for _ in EDITS:
        walker.hear("edit")


async def test_every_kind_of_edit_follows_the_protocol(program: Program, live_server: LiveServer) -> None:
    def play(address: str) -> None:
        with character(program, address) as walker:
            walker.tell("wait 40")
            walker.hear("frame")
            edit_in_every_way(walker)
            walker.tell("close")

    async with asyncio.timeout(LIMIT_S), RulesRelay(live_server.address) as relay:
        await asyncio.to_thread(play, relay.address)
        assert relay.broken == []
        (told,) = relay.streams[0].sessions.values()
        assert told.kinds.count("close") == 1
        assert told.kinds.count("playhead") > 1
        assert told.sent_seq == 1 + 2 * len(EDITS) + 1


async def test_resuming_a_session_follows_the_protocol(program: Program, live_server: LiveServer) -> None:
    def play(behind: str) -> None:
        with BlockingLine(behind) as proxy, character(program, proxy.address) as walker:
            walker.tell("wait 40")
            walker.hear("frame")
            for _ in range(3):
                walker.tell("prompt a person runs forward")
                proxy.cut()
                walker.tell("prompt a person waves")
                walker.hear_each("recovered", "edit", "edit")
            edit_in_every_way(walker)

    async with asyncio.timeout(LIMIT_S), RulesRelay(live_server.address) as relay:
        await asyncio.to_thread(play, relay.address)
        assert relay.broken == []
        assert max(told.attempt for told in relay.kept.values()) >= 3
