"""Outputs on request: further blocks of frame rows, in sessions and clips."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_compliance.talk import LIMIT_S, rig_of
from motiongen_compliance.target import Target


def columns(rig: motion_pb2.Rig, outputs: list[motion_pb2.ChannelBlock]) -> dict[str, slice]:
    """The columns of each block in a row with these outputs."""
    found, start = {}, 0
    for block in (*rig.blocks, *outputs):
        found[block.name] = slice(start, start + block.width)
        start += block.width
    return found


@pytest.fixture
def offered(target: Target) -> list[motion_pb2.ChannelBlock]:
    return list(target.catalog.models[0].outputs)


async def test_session_has_the_requested_outputs_in_their_order(
    target: Target, offered: list[motion_pb2.ChannelBlock]
) -> None:
    asked = offered[::-1]
    talk = await target.talk()
    heard = await talk.open(1, outputs=[block.name for block in asked])
    assert heard.opened is not None
    assert list(heard.opened.outputs) == asked
    while heard.end < 40:
        await talk.plays_on(1)


async def test_positions_and_velocities_match_their_frames_roots(
    target: Target, offered: list[motion_pb2.ChannelBlock]
) -> None:
    names = {block.name for block in offered} & {"joint_positions_m", "joint_velocities_mps"}
    asked = [block for block in offered if block.name in names]
    rig, talk = rig_of(target.catalog), await target.talk()
    heard = await talk.open(1, outputs=[block.name for block in asked])
    while heard.end < 60:
        await talk.plays_on(1)
    rows = np.stack([np.frombuffer(heard.frames[frame], "<f4") for frame in range(heard.end)])
    where = columns(rig, asked)
    root = rows[:, where["root_translation_m"]]
    if "joint_positions_m" in names:
        np.testing.assert_allclose(rows[:, where["joint_positions_m"]][:, :3], root, atol=1e-5)
    if "joint_velocities_mps" in names:
        speed = rows[:, where["joint_velocities_mps"]][:, :3]
        assert not speed[0].any(), "the first frame has no speed"
        np.testing.assert_allclose(speed[1:], np.diff(root, axis=0) * rig.frame_rate, atol=1e-3)


async def test_clip_has_the_requested_outputs(target: Target, offered: list[motion_pb2.ChannelBlock]) -> None:
    opening = session_pb2.OpenSession(outputs=[block.name for block in offered])
    width = 4 * sum(block.width for block in (*rig_of(target.catalog).blocks, *offered))
    request = service_pb2.GenerateClipRequest(open=opening, frame_count=30)
    async for response in target.stub.GenerateClip(request, timeout=LIMIT_S):
        if response.HasField("opened"):
            assert list(response.opened.outputs) == offered
        elif response.HasField("chunk"):
            assert len(response.chunk.data) == width * response.chunk.frame_count


async def test_resumed_session_keeps_its_outputs(target: Target, offered: list[motion_pb2.ChannelBlock]) -> None:
    first = await target.talk()
    heard = await first.open(1, outputs=[block.name for block in offered])
    first.call.cancel()
    second = await target.talk()
    await second.resume(1, heard)
    assert heard.opened is not None
    assert list(heard.opened.outputs) == offered
    await second.plays_on(1)


@pytest.mark.parametrize("twice", [False, True])
async def test_unknown_or_repeated_output_is_refused(
    target: Target, offered: list[motion_pb2.ChannelBlock], twice: bool
) -> None:
    name = offered[0].name if twice and offered else "heart_rate"
    talk = await target.talk()
    await talk.ask_open(1, outputs=[name, name] if twice and offered else [name])
    outcome = await talk.answer(1, 1)
    expected = "open.outputs[1]" if twice and offered else "open.outputs[0]"
    assert (outcome.reason, outcome.field) == ("UNKNOWN_OUTPUT", expected)
    assert outcome.allowed
