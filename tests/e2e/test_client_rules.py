"""The Python client keeps the rules of the protocol: a relay between it and a server checks every message."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from motiongen_client import EventRefused, MotionClient, Session, Waypoint
from motiongen_client.edit import Edit
from tests.conftest import LiveServer
from tests.contract.rules_relay import RulesRelay
from tests.e2e.tcp_proxy import TcpProxy
from tests.waiting import LIMIT_S


def edits(walker: Session) -> Iterator[Edit]:
    """One edit of each kind, and one that is refused."""
    yield walker.set_prompt("a person runs forward")
    later = walker.set_prompt("a person waves", frame=600, end_frame=700)
    yield later
    assert later.prompt_id is not None
    yield walker.set_prompt("a person jumps", frame=610, end_frame=650, prompt_id=later.prompt_id)
    yield walker.remove_prompts([later.prompt_id])
    placed = walker.add_waypoint(1, 2, frame=700)
    yield placed
    yield walker.go_to(2, 4)
    yield walker.replace_constraint(placed.constraint_ids[0], Waypoint(710, 1, 2))
    yield walker.remove_constraints(placed.constraint_ids)
    yield walker.remove_constraints([9999])
    yield walker.clear_constraints()
    yield walker.set_velocity(0, 1, seconds=2)
    yield walker.pause()
    yield walker.resume()
    yield walker.set_options(denoise_steps=2)
    yield walker.teleport(3, 3)


async def answered(edit: Edit) -> bool:
    """Whether the edit was accepted."""
    try:
        await edit
    except EventRefused:
        return False
    return True


async def play(walker: Session, seconds: float) -> None:
    async for _ in walker.frames(seconds, realtime=False):
        pass


@pytest.mark.filterwarnings("ignore")
async def test_every_kind_of_edit_keeps_the_rules(live_server: LiveServer) -> None:
    async with asyncio.timeout(LIMIT_S), RulesRelay(live_server.address) as relay:
        async with MotionClient(relay.address) as client:
            walker = await client.open("a person walks forward")
            await play(walker, 2)
            assert await answered(walker.seek(walker.playback.playhead - 4))
            taken = [await answered(edit) for edit in edits(walker)]
            assert taken.count(False) == 1
            together = list(edits(walker))
            assert [await answered(edit) for edit in together].count(False) == 1
            await walker.close()
        assert relay.broken == []
        (told,) = relay.streams[0].sessions.values()
        assert told.kinds.count("playhead") > 0
        assert told.sent_seq == 2 + 2 * len(taken) + 1


@pytest.mark.filterwarnings("ignore")
async def test_resuming_keeps_the_rules(live_server: LiveServer) -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        RulesRelay(live_server.address) as relay,
        TcpProxy(relay.address) as proxy,
    ):
        async with MotionClient(proxy.address) as client:
            walker = await client.open("a person walks forward")
            await play(walker, 2)
            for number in range(3):
                said = walker.set_prompt("a person runs forward")
                proxy.cut()
                late = walker.set_prompt("a person waves")
                assert await answered(said), number
                assert await answered(late), number
                await play(walker, 1)
            assert [await answered(edit) for edit in edits(walker)].count(False) == 1
            assert (walker.stats.resumes, walker.reopenings) == (3, ())
            await walker.close()
        assert relay.broken == []
        (told,) = relay.kept.values()
        assert told.attempt >= 3
