"""A walking or running character that is sent back turns round as people do, without flipping over."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import AsyncIterator

import numpy as np
import pytest

from motiongen_client import MotionClient, Session, SessionOptions, StartPose
from motiongen_tools.server_process import ServerProcess
from tests.bench.changes import FPS, SETTINGS, hips_rad_s

AHEAD_S, MOST_S = 3.0, 20.0
BACK_M, NEAR_M = 6.0, 0.3
"""Distances from where it is sent back. When it turns depends on how soon the server handles the edit."""
GAITS = ((1.3, "a person walks forward"), (2.0, "a person jogs"), (3.0, "a person runs forward"))
SEEDS = range(3)
HIPS_RAD_S = 7.0
"""Roots turn at 3.2 rad/s at most, and sway adds 1, hips another 1; a flip is 12 or more."""
FASTER = 1.5
"""Relative to its fastest limb before, while it went straight on."""


async def poses(session: Session, seconds: float) -> AsyncIterator[np.ndarray]:
    async for frame in session.frames(seconds, realtime=False):
        yield frame.joint_positions_m().astype(np.float64)


async def sent_back(client: MotionClient, speed_m_s: float, prompt: str, seed: int, by_place: bool) -> np.ndarray:
    """Joint positions (T, J, 3) of a character that goes along +X, a little longer with each seed, and then back.

    by_place: by a target place, before which the velocity still in force yields; else by another velocity.
    """
    options = SessionOptions(seed=seed, start=StartPose(0.0, 0.0, math.pi / 2), lookahead_frames=40)
    async with await client.open("a person stands", options=options) as session:
        await session.set_prompt(prompt)
        await session.set_velocity(speed_m_s, 0.0, seconds=MOST_S)
        made = [pose async for pose in poses(session, AHEAD_S + 0.35 * seed)]
        there_m = made[-1][0, 0] - BACK_M
        if by_place:
            await session.go_to(there_m, 0.0)
        else:
            await session.set_velocity(-speed_m_s, 0.0, seconds=MOST_S)
        async for pose in poses(session, MOST_S):
            made.append(pose)
            if pose[0, 0] < there_m + NEAR_M:
                return np.array(made)
    raise AssertionError(f"{prompt}, seed {seed}: it never went back")


def fastest_m_s(joints_m: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(joints_m, axis=0), axis=-1).max() * FPS)


@pytest.mark.parametrize("by_place", [False, True], ids=["stick", "place"])
async def test_character_that_is_sent_back_does_not_flip(by_place: bool) -> None:
    with ServerProcess(SETTINGS) as server:
        async with MotionClient(server.address) as client:
            names = list(client.catalog.rig(client.catalog.models[0].rig_id).joint_names)
            hips = names.index("RightUpLeg"), names.index("LeftUpLeg")
            cases = list(itertools.product(GAITS, SEEDS))
            walks = await asyncio.gather(*(sent_back(client, *gait, seed, by_place) for gait, seed in cases))
    for (gait, seed), joints_m in zip(cases, walks, strict=True):
        ahead = round(FPS * (AHEAD_S + 0.35 * seed))
        turning = hips_rad_s(joints_m[ahead - 1 :], hips)
        assert turning.max() < HIPS_RAD_S, f"{gait}, seed {seed}: frame {ahead + int(turning.argmax())}"
        assert fastest_m_s(joints_m[ahead - 1 :]) < FASTER * fastest_m_s(joints_m[FPS:ahead]), f"{gait}, seed {seed}"
