"""Where the timeline shows that a plan begins."""

from __future__ import annotations

import asyncio

from motiongen_tools.view.bridge import Bridge
from motiongen_tools.view.room import Room
from tests.client.synthetic import synthetic_rows
from tests.waiting import LIMIT_S


async def test_a_seam_is_at_the_first_frame_of_a_plan_and_not_of_the_new_frames(bridge: Bridge, room: Room) -> None:
    (number,) = await room.add({"count": 1})
    character = room.characters[number]
    playback = character.session.playback
    async with asyncio.timeout(LIMIT_S):
        while not playback.buffered_to:
            await bridge.beat()
    character.tick()
    end, plan = playback.buffered_to, playback.plan
    playback.add_chunk(plan, end, synthetic_rows(plan, end, 8), playback.committed_to)
    playback.announce_plan(plan + 1, end + 4)
    playback.add_chunk(plan + 1, end + 4, synthetic_rows(plan + 1, end + 4, 8), playback.committed_to)
    character.tick()
    assert character.shown()["seams"][-1] == end + 4
