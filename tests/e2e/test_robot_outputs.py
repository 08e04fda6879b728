"""A server with a random-weight model of the robot's rig: g1_qpos and g1_qvel in streams and in clips."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator

import numpy as np
import pytest
import torch

from motiongen_ardy.robot.g1 import load_g1
from motiongen_ardy.robot.rows import qpos_of_rows, qvel_between
from motiongen_client import EventRefused, FrameFormat, Motion, MotionClient, SessionOptions
from motiongen_tools.server_process import ServerProcess
from tests.conftest import ROOT

MODEL = ROOT / "tests" / "data" / "golden" / "tiny-g134" / "checkpoint"
OUTPUTS = ("g1_qpos", "g1_qvel")
FRAMES = 60


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    settings = ["--model", str(MODEL), "--text-encoder", "hashed", "--devices", "cpu:1", "--playback-rate", "1000"]
    settings += ["--profile-s", "0.3", "--admit-load", "1000", "--degrade", "false"]
    with ServerProcess(settings) as server:
        yield server.address


@pytest.fixture
async def client(address: str) -> AsyncIterator[MotionClient]:
    async with MotionClient(address) as connected:
        yield connected


def check(motion: Motion) -> None:
    """Check that the robot's numbers match the frames that they came with."""
    qpos, qvel = motion.output("g1_qpos"), motion.output("g1_qvel")
    assert (qpos.shape, qvel.shape) == ((FRAMES, 36), (FRAMES, 35))
    turns = torch.from_numpy(motion.joint_rotation_quat_wxyz.copy())
    expected = qpos_of_rows(turns, torch.from_numpy(motion.root_translation_m.copy()))
    np.testing.assert_allclose(qpos, expected, atol=1e-4)
    assert (qpos[1:, 3:7] * qpos[:-1, 3:7]).sum(axis=1).min() >= 0, "of q and -q, the one nearer to the frame before"
    robot = load_g1()
    assert (qpos[:, 7:] >= robot.lower.numpy() - 1e-6).all()
    assert (qpos[:, 7:] <= robot.upper.numpy() + 1e-6).all()
    led = qvel_between(expected, motion.rig.frame_rate_hz)
    np.testing.assert_allclose(qvel[1:], led, atol=0.02)


async def test_robot_outputs_match_the_frames_on_both_sides_of_a_replan(client: MotionClient) -> None:
    model = client.catalog.models[0]
    assert {name: model.outputs[name] for name in OUTPUTS} == {"g1_qpos": 36, "g1_qvel": 35}
    walker = await client.open("a person walks", options=SessionOptions(seed=1, outputs=OUTPUTS))
    async for frame in walker.frames(FRAMES / walker.rig.frame_rate_hz, realtime=False):
        if frame.index == 20:
            walker.set_prompt("a person waves")
    assert walker.stats.plans > 1
    check(walker.motion(0, FRAMES))


async def test_clip_has_matching_robot_outputs(client: MotionClient) -> None:
    options = SessionOptions(seed=1, outputs=OUTPUTS)
    (clip,) = await client.generate_clip("a person walks", num_frames=FRAMES, options=options)
    check(clip.motion)


async def test_robot_outputs_cannot_be_quantised(client: MotionClient) -> None:
    options = SessionOptions(outputs=OUTPUTS, frame_format=FrameFormat.QUANTISED)
    with pytest.raises(EventRefused, match="OUTPUT_NOT_QUANTISED"):
        await client.open("a person walks", options=options)
