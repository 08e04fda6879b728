"""How frames are stored: compact forms of the same motion stay within the errors that the protocol promises."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_compliance.heard import Heard
from motiongen_compliance.messages import edit_prompts, span
from motiongen_compliance.talk import LIMIT_S, rig_of
from motiongen_compliance.target import Target

F32, F16, QUANTISED = (
    motion_pb2.SCALAR_TYPE_F32_LE,
    motion_pb2.SCALAR_TYPE_F16_LE,
    motion_pb2.SCALAR_TYPE_QUANTISED,
)
ROUNDING = 1e-3
"""Additional tolerance, metres and radians: the same seed gives the same motion only to within rounding."""
Numbers = NDArray[np.float64]


def columns(rig: motion_pb2.Rig, name: str) -> slice:
    start = 0
    for block in rig.blocks:
        if block.name == name:
            return slice(start, start + block.width)
        start += block.width
    raise LookupError(f"the rig has no block {name}")


def read(chunk: motion_pb2.FrameChunk, rig: motion_pb2.Rig, row_bytes: int) -> tuple[Numbers, Numbers]:
    """Root positions (T, 3) and joint rotations (T, J, 4) of a chunk in any form."""
    num_joints, data = len(rig.joints), np.frombuffer(chunk.data, np.uint8).reshape(chunk.frame_count, row_bytes)
    if chunk.scalar_type == QUANTISED:
        root = np.ascontiguousarray(data[:, :12]).view("<i4") / 1000
        return root, unpacked(np.ascontiguousarray(data[:, 12 : 12 + 4 * num_joints]).view("<u4"))
    rows = data.view("<f2" if chunk.scalar_type == F16 else "<f4").astype(np.float64)
    root = rows[:, columns(rig, "root_translation_m")] + (chunk.root_origin_m or 0.0)
    return root, rows[:, columns(rig, "joint_rotation_quat_wxyz")].reshape(len(rows), num_joints, 4)


def unpacked(words: NDArray[np.uint32]) -> Numbers:
    """Quaternions (..., 4) from words that store their three smallest components."""
    greatest = words >> 30
    three = np.stack([words >> shift & 1023 for shift in (20, 10, 0)], axis=-1)
    three = (three - 511.5) / (511 * np.sqrt(2))
    missing = np.sqrt(np.maximum(1 - (three**2).sum(axis=-1), 0))
    found = np.empty((*words.shape, 4))
    for index in range(4):
        others = [each for each in range(4) if each != index]
        here = greatest == index
        found[here, index] = missing[here]
        for place, other in enumerate(others):
            found[here, other] = three[here, place]
    return found


def all_of(heard: Heard, rig: motion_pb2.Rig) -> tuple[Numbers, Numbers]:
    parts = [read(chunk, rig, heard.row_bytes) for chunk in heard.chunks]
    return np.concatenate([root for root, _ in parts]), np.concatenate([turns for _, turns in parts])


def apart_rad(one: Numbers, other: Numbers) -> float:
    """The greatest angle between corresponding rotations."""
    unit = [turns / np.linalg.norm(turns, axis=-1, keepdims=True) for turns in (one, other)]
    chord = np.minimum(*(np.linalg.norm(unit[0] - sign * unit[1], axis=-1) for sign in (1, -1)))
    return float(4 * np.arcsin(np.minimum(chord / 2, 1)).max())


@pytest.mark.parametrize(("scalar_type", "metres", "radians"), [(F16, 0.001, 0.0015), (QUANTISED, 0.0006, 0.0035)])
async def test_session_in_a_compact_form_has_the_same_motion(
    target: Target, scalar_type: int, metres: float, radians: float
) -> None:
    talk, rig = await target.talk(), rig_of(target.catalog)
    sessions = [
        await talk.open(handle, seed=7, scalar_type=form, prompts=[span("walk")])
        for handle, form in enumerate((F32, scalar_type))
    ]
    for heard in sessions:
        assert heard.opened is not None
        most = heard.opened.lookahead_frames
        await talk.until(lambda heard=heard, most=most: heard.end == most)
    assert sessions[1].opened is not None
    assert sessions[1].opened.scalar_type == scalar_type
    (root, turns), (shorter_root, shorter_turns) = (all_of(heard, rig) for heard in sessions)
    np.testing.assert_allclose(shorter_root, root, atol=metres + ROUNDING)
    assert apart_rad(turns, shorter_turns) <= radians + ROUNDING
    await talk.plays_on(1)


@pytest.mark.parametrize("scalar_type", [F16, QUANTISED])
async def test_clip_in_a_compact_form_has_the_same_motion(target: Target, scalar_type: int) -> None:
    rig, found = rig_of(target.catalog), []
    for form in (F32, scalar_type):
        opening = session_pb2.OpenSession(seed=7, scalar_type=form, prompts=[span("walk")])  # type: ignore[arg-type]
        request = service_pb2.GenerateClipRequest(open=opening, frame_count=10)
        parts = [part async for part in target.stub.GenerateClip(request, timeout=LIMIT_S)]
        chunks = [part.chunk for part in parts if part.HasField("chunk")]
        assert {chunk.scalar_type for chunk in chunks} == {form}
        read_as = [read(chunk, rig, len(chunk.data) // chunk.frame_count) for chunk in chunks]
        found.append([np.concatenate(each) for each in zip(*read_as, strict=True)])
    np.testing.assert_allclose(found[1][0], found[0][0], atol=0.001 + ROUNDING)
    assert apart_rad(found[0][1], found[1][1]) <= 0.0035 + ROUNDING


async def test_rotations_have_length_1_and_keep_their_sign_from_frame_to_frame(target: Target) -> None:
    talk, rig = await target.talk(), rig_of(target.catalog)
    heard = await talk.open(1, prompts=[span("walk")])
    for text in ("turn around", "dance"):
        while heard.end < 100 * len(text) // 5:
            await talk.plays_on(1)
        assert (await talk.edit(1, edit_prompts(span(text)))).code == 0
    await talk.plays_on(1)
    rows = np.stack([np.frombuffer(heard.frames[frame], "<f4") for frame in range(heard.next_frame)])
    turns = rows[:, columns(rig, "joint_rotation_quat_wxyz")].reshape(len(rows), len(rig.joints), 4).astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(turns, axis=-1), 1, atol=1e-3)
    assert ((turns[1:] * turns[:-1]).sum(axis=-1) > -1e-6).all(), "a sign changes from one frame to the next"
