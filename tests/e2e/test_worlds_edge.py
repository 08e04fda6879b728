"""The built-in model at the edge of the world, and beyond: it walks there as it walks in the middle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motiongen_client import MotionClient, SessionOptions, StartPose, Waypoint
from motiongen_tools.server_process import ServerProcess

SETTINGS = ("--devices", "cpu:1", "--profile-s", "0.3", "--admit-load", "1000", "--degrade", "false")
EDGE_M = 9_999.9
NUM_FRAMES = 160
FPS = 20


async def speeds(client: MotionClient, start_m: float, *waypoints: Waypoint) -> np.ndarray:
    """Speeds of the hips, frame by frame, m/s, of a character that walks along +X from start_m."""
    options = SessionOptions(seed=5, start=StartPose(start_m, 0.0, math.pi / 2))
    (clip,) = await client.generate_clip(
        "a person walks forward", num_frames=NUM_FRAMES, options=options, constraints=waypoints
    )
    hips = clip.motion.joint_positions_m()[:, 0].astype(np.float64)
    return FPS * np.linalg.norm(np.diff(hips, axis=0), axis=1)


async def test_motion_at_the_edge_is_as_smooth_as_in_the_middle() -> None:
    with ServerProcess(SETTINGS) as server:
        async with MotionClient(server.address) as client:
            middle = await speeds(client, 0.0)
            outward = await speeds(client, EDGE_M)
            far = await speeds(client, 0.0, Waypoint(NUM_FRAMES - 10, -EDGE_M, 0.0))
            back = await speeds(client, EDGE_M, Waypoint(NUM_FRAMES - 10, -EDGE_M, 0.0))
    assert np.median(outward) == pytest.approx(np.median(middle), abs=0.3)
    assert outward.max() < middle.max() + 0.5
    assert max(far.max(), back.max()) < 10.0, "a target out of reach must not throw the character"
