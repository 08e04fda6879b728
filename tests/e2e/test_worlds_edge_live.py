"""Live sessions at the edge of the world move as in the middle, whatever edits they get."""

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
"""Relative to the middle of the world with the same edits: a model's motion is not exactly the same elsewhere."""

Leg = Callable[[Session, float], Edit]
"""An edit. sign: 1 or -1, the edge of the world at which the session is, or which it faces from the middle."""

# No leg reverses a run: how limbs move then depends on where the plan begins. `test_turning_back` has that.
LEGS: tuple[Leg, ...] = (
    lambda session, sign: session.set_prompt("a person walks forward"),
    lambda session, sign: session.set_velocity(sign * 3.0, 0.0, seconds=LEG_S),  # outward
    lambda session, sign: session.set_prompt("a person runs forward"),
    lambda session, sign: session.set_prompt("a person waves"),
    lambda session, sign: session.go_to(-sign * WORLD_M, 0.0),  # the other end
    lambda session, sign: session.set_constraints(()),
    lambda session, sign: session.set_velocity(0.0, sign * 2.0, seconds=LEG_S),  # along the edge
    lambda session, sign: session.go_to(sign * WORLD_M, sign * WORLD_M),  # straight on to a corner
    lambda session, sign: session.set_constraints(()),
)


@dataclass(frozen=True)
class Walk:
    """The result of all legs. joints_m: (T, J, 3) of consecutive frames, the hips first."""

    frames: list[int]
    joints_m: np.ndarray
    num_plans: int
    num_late_plans: int
    num_resumes: int

    @property
    def hips_mps(self) -> np.ndarray:
        return FPS * np.linalg.norm(np.diff(self.joints_m[:, 0], axis=0), axis=-1)

    def at_its_fastest(self) -> str:
        """The positions of the hips around the fastest frame, and its leg."""
        frame = int(self.hips_mps.argmax())
        places = np.round(self.joints_m[max(0, frame - 3) : frame + 4, 0], 2).tolist()
        return f"frame {frame}, leg {frame // round(LEG_S * FPS)}: {places}"

    @property
    def joints_mps(self) -> np.ndarray:
        """The speed of the fastest joint, frame by frame, which shows limbs that jump."""
        return FPS * np.linalg.norm(np.diff(self.joints_m, axis=0), axis=-1).max(axis=1)


def standing_at(x_m: float) -> SessionOptions:
    """Options for a start at x_m, facing outward."""
    return SessionOptions(seed=5, start=StartPose(x_m, 0.0, math.copysign(math.pi / 2, x_m)), lookahead_frames=40)


async def led(client: MotionClient, start_m: float) -> Walk:
    """Lead a session through all legs; each begins while frames of the one before are still to be played."""
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
    """The address of a server with the built-in model."""
    with ServerProcess(SETTINGS) as server:
        yield server.address


async def test_session_at_the_edge_is_as_fast_and_smooth_as_in_the_middle(address: str) -> None:
    async with MotionClient(address) as client:
        starts_m = (0.0, -0.0, EDGE_M, -EDGE_M)
        *middles, east, west = await asyncio.gather(*(led(client, start_m) for start_m in starts_m))
    for walk, middle in zip((east, west), middles, strict=True):
        assert walk.frames == list(range(len(LEGS) * round(LEG_S * FPS))), "a frame is missing or came twice"
        assert walk.num_plans > len(LEGS), "the edits make new plans, whose seams are among these frames"
        assert walk.num_late_plans == middle.num_late_plans == 0, "a frame that was played was replaced"
        assert walk.num_resumes == 0
        assert np.isfinite(walk.joints_m).all()
        assert walk.hips_mps.max() < FASTER * middle.hips_mps.max(), walk.at_its_fastest()
        assert walk.joints_mps.max() < FASTER * middle.joints_mps.max()
        # Characters are not moved back: one that is led over the edge walks on there.
        assert np.abs(walk.joints_m[:, 0, 0]).max() > WORLD_M


async def test_target_beyond_the_edge_is_refused_but_a_relative_one_is_reached(address: str) -> None:
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
    assert beside[-1] < 1.0  # nothing says where it goes after that
