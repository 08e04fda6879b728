"""A standing character that is sent a short way goes there in steps: no foot jumps from one frame to the next."""

from __future__ import annotations

import asyncio
import itertools
import math

import numpy as np
import pytest

from motiongen_client import MotionClient, SessionOptions, StartPose
from motiongen_tools.server_process import ServerProcess
from tests.bench.changes import SETTINGS, hardest_m_s2

STANDS_S, WAY_S = 1.5, 4.0
PLACES_M = ((0.5, 0.3), (-0.4, 0.0))
"""The way along +X, which it faces, and along +Z."""
SEEDS = range(12)
HARDEST_M_S2 = 100.0
"""Acceleration of any joint relative to the root. Captured walks have at most 80; a foot that jumps has 140 to 180."""
NEAR_M = 0.05


async def sent(client: MotionClient, place_m: tuple[float, float], seed: int) -> np.ndarray:
    """Joint positions (T, J, 3) from when it is sent. It stands a little longer with each seed before that."""
    options = SessionOptions(seed=seed, start=StartPose(0.0, 0.0, math.pi / 2), lookahead_frames=40)
    async with await client.open("a person stands still", options=options) as session:
        stood = [frame async for frame in session.frames(STANDS_S + 0.35 * seed, realtime=False)][-2:]
        root = stood[-1].joint_positions_m()[0]
        await session.go_to(float(root[0]) + place_m[0], float(root[2]) + place_m[1])
        made = stood + [frame async for frame in session.frames(WAY_S, realtime=False)]
        return np.array([frame.joint_positions_m() for frame in made], np.float64)


@pytest.mark.timeout(180)
async def test_no_foot_jumps_when_a_standing_character_is_sent_a_short_way() -> None:
    cases = list(itertools.product(PLACES_M, SEEDS))
    with ServerProcess(SETTINGS) as server:
        async with MotionClient(server.address) as client:
            ways = await asyncio.gather(*(sent(client, place, seed) for place, seed in cases))
    for (place, seed), joints_m in zip(cases, ways, strict=True):
        off_m = np.linalg.norm(joints_m[:, 0, [0, 2]] - joints_m[1, 0, [0, 2]] - place, axis=-1)
        assert off_m.min() < NEAR_M, f"{place}, seed {seed}: no nearer than {off_m.min()} m"
        hardest = hardest_m_s2(joints_m)
        assert hardest.max() < HARDEST_M_S2, f"{place}, seed {seed}: {hardest.max():.0f} at {int(hardest.argmax()) + 1}"
