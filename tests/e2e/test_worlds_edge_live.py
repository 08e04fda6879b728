"""Sessions that are led about at the end of the world, live: as in the middle, whatever they are told."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from motiongen_client import Edit, EventRefused, MotionClient, Session, SessionOptions, StartPose
from motiongen_tools.server_process import ServerProcess

SETTINGS = (
    "--devices", "cpu:1", "--profile-s", "0.3", "--admit-load", "1000", "--degrade", "false",
    "--playback-rate", "1000",
)  # fmt: skip
EDGE_M = 9_999.9
WORLD_M = 10_000.0
FPS = 20
LEG_S = 2.5
FASTER = 1.5
"""Than at most in the middle of the world, told the same: a model does not repeat itself to the letter elsewhere."""

Leg = Callable[[Session, float], Edit]
"""What a session is told. sign: of the end of the world that it is at, or that it faces from the middle, 1 or -1."""

# Nobody is turned right about out of a run, where limbs go as the frame will have it at which the plan begins: that is
# `test_turning_back`'s.
LEGS: tuple[Leg, ...] = (
    lambda session, sign: session.set_prompt("a person walks forward"),
    lambda session, sign: session.set_velocity(sign * 3.0, 0.0, seconds=LEG_S),  # outward
    lambda session, sign: session.set_prompt("a person runs forward"),
    lambda session, sign: session.set_prompt("a person waves"),
    lambda session, sign: session.go_to(-sign * WORLD_M, 0.0),  # the other end
    lambda session, sign: session.set_constraints(()),
    lambda session, sign: session.set_velocity(0.0, sign * 2.0, seconds=LEG_S),  # along the edge
    lambda session, sign: session.go_to(sign * WORLD_M, sign * WORLD_M),  # on to a corner, from the edge straight on
    lambda session, sign: session.set_constraints(()),
)


@dataclass(frozen=True)
class Walk:
    """What came of all legs. joints_m: (T, J, 3) of frames one after another, the hips first."""

    frames: list[int]
    joints_m: np.ndarray
    num_plans: int
    num_late_plans: int
    num_resumes: int

    @property
    def hips_mps(self) -> np.ndarray:
        return FPS * np.linalg.norm(np.diff(self.joints_m[:, 0], axis=0), axis=-1)

    def at_its_fastest(self) -> str:
        """Where the hips are around that frame, and in which leg that is."""
        frame = int(self.hips_mps.argmax())
        places = np.round(self.joints_m[max(0, frame - 3) : frame + 4, 0], 2).tolist()
        return f"frame {frame}, leg {frame // round(LEG_S * FPS)}: {places}"

    @property
    def joints_mps(self) -> np.ndarray:
        """Of the fastest joint, frame by frame: a limb that jumps is seen here."""
        return FPS * np.linalg.norm(np.diff(self.joints_m, axis=0), axis=-1).max(axis=1)


def standing_at(x_m: float) -> SessionOptions:
    """Facing outward."""
    return SessionOptions(seed=5, start=StartPose(x_m, 0.0, math.copysign(math.pi / 2, x_m)), lookahead_frames=40)


async def led(client: MotionClient, start_m: float) -> Walk:
    """Lead a session through all legs; a new one begins while what was made for the one before is in hand."""
    indices, joints = [], []
    async with await client.open("a person stands", options=standing_at(start_m)) as session:
        for leg in LEGS:
            await leg(session, math.copysign(1.0, start_m))
            async for frame in session.frames(LEG_S, realtime=False):
                indices.append(frame.index)
                joints.append(frame.joint_positions_m().astype(np.float64))
        stats = session.stats
    return Walk(indices, np.array(joints), stats.plans, stats.late_plans, stats.resumes + stats.reopenings)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a server with the built-in model."""
    with ServerProcess(SETTINGS) as server:
        yield server.address


async def test_who_is_led_about_at_the_edge_is_as_fast_and_as_smooth_as_in_the_middle(address: str) -> None:
    async with MotionClient(address) as client:
        starts_m = (0.0, -0.0, EDGE_M, -EDGE_M)
        *middles, east, west = await asyncio.gather(*(led(client, start_m) for start_m in starts_m))
    for walk, middle in zip((east, west), middles, strict=True):
        assert walk.frames == list(range(len(LEGS) * round(LEG_S * FPS))), "none left out, none twice"
        assert walk.num_plans > len(LEGS), "what it was told made new plans, whose seams are among these frames"
        assert walk.num_late_plans == middle.num_late_plans == 0, "no frame that was taken was replaced"
        assert walk.num_resumes == 0
        assert np.isfinite(walk.joints_m).all()
        assert walk.hips_mps.max() < FASTER * middle.hips_mps.max(), walk.at_its_fastest()
        assert walk.joints_mps.max() < FASTER * middle.joints_mps.max()
        # Nobody is set back into the world: who is led over its edge walks on there.
        assert np.abs(walk.joints_m[:, 0, 0]).max() > WORLD_M


async def test_a_place_beyond_the_edge_is_refused_and_one_ahead_of_who_stands_there_is_reached(address: str) -> None:
    async with (
        MotionClient(address) as client,
        await client.open("a person stands", options=standing_at(EDGE_M)) as session,
    ):
        with pytest.raises(EventRefused, match="COORDINATE_OUT_OF_RANGE"):
            await session.go_to(WORLD_M + 1.0, 0.0)
        with pytest.raises(EventRefused, match="COORDINATE_OUT_OF_RANGE"):
            await session.teleport(WORLD_M + 1.0, 0.0)
        await session.go_to(0.0, 2.0, is_relative=True)
        hips = [frame.joint_positions_m()[0] async for frame in session.frames(4.0, realtime=False)]
    beside = [abs(place[0] - (EDGE_M + 2.0)) for place in hips]
    assert min(beside) < 0.3
    assert beside[-1] < 1.0  # where it goes from there, nobody has said
