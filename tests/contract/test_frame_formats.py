"""The frame formats: the client reads what the server writes, within the promised errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_client import FrameFormat, Motion, ProtocolViolation, Rig
from motiongen_client.convert import FrameReader
from motiongen_client.kinematics import quaternion_to_matrix
from motiongen_server.engine.types import ChannelBlock, Chunk, EventRefused, Guidance, SessionKey
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import append_frames, engine_event
from motiongen_server.rpc.convert.frames import F16, F32, QUANTISED, FrameCoding
from motiongen_server.rpc.limits import Limits
from motiongen_server.rpc.send_queue import Run
from tests.server.engine.fakes import FACTS

J = 27
BLOCKS = {"root_translation_m": 3, "joint_rotation_quat_wxyz": 4 * J, "foot_contact": 4}
RIG = Rig(
    "r", tuple(f"j{n}" for n in range(J)), (-1, *range(J - 1)), np.zeros((J, 3), np.float32), 20, BLOCKS, None, {}
)
FORMATS = {F32: FrameFormat.F32, F16: FrameFormat.F16, QUANTISED: FrameFormat.QUANTISED}


def walk(frames: int) -> np.ndarray:
    """Rows of a character that turns every joint evenly about its own axis, 400 m away from the origin."""
    generator, time = np.random.default_rng(3), np.arange(frames)[:, None] / 20
    axes = generator.normal(size=(J, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angle = (generator.uniform(-3, 3, J) + time * generator.uniform(-3, 3, J))[..., None]
    turns = np.concatenate([np.cos(angle), np.sin(angle) * axes], axis=-1)
    root = np.array([400.0, 0.9, -200.0]) + time * [1.0, 0.0, 0.5]
    contacts = generator.integers(0, 2, (frames, 4))
    return np.concatenate([root, turns.reshape(frames, -1), contacts], axis=1).astype(np.float32)


def sent(
    rows: np.ndarray, scalar_type: int, parts: int = 1, blocks: tuple[ChannelBlock, ...] = ()
) -> motion_pb2.FrameChunk:
    response: list[bytes | memoryview] = []
    run = Run(Chunk(SessionKey(1, 1), 3, 8, rows, 4), 2, None)
    run.parts = np.array_split(rows, parts)
    append_frames(response, run, FrameCoding(scalar_type, J, blocks))
    message = service_pb2.StreamMotionResponse.FromString(b"".join(response))
    return message.updates[0].chunk


def test_f16_roots_after_a_cut_are_as_exact_as_before() -> None:
    """F16 stores offsets from a chunk's first root: 400 m away from it, the error would be 12 cm."""
    rows = walk(20)
    rows[12:, :3] -= [800.0, 0.0, 0.0]
    response: list[bytes | memoryview] = []
    append_frames(response, Run(Chunk(SessionKey(1, 1), 3, 8, rows, 4), 2, None), FrameCoding(F16, J))
    updates = service_pb2.StreamMotionResponse.FromString(b"".join(response)).updates
    chunks = [update.chunk for update in updates]
    assert [(each.first_frame, each.frame_count) for each in chunks] == [(8, 12), (20, 8)]
    assert {(each.plan, each.committed_to) for each in chunks} == {(3, 4)}
    assert {(update.session, update.applied_seq) for update in updates} == {(1, 2)}
    read = np.concatenate([FrameReader(RIG, FrameFormat.F16).rows(each) for each in chunks])
    assert np.abs(read[:, :3] - rows[:, :3]).max() < 1e-3


def worst_angle_rad(one: np.ndarray, other: np.ndarray) -> float:
    first, second = (rows[:, 3:-4].reshape(len(rows), -1, 4).astype(np.float64) for rows in (one, other))
    between = quaternion_to_matrix(first).swapaxes(-1, -2) @ quaternion_to_matrix(second)
    sine = np.linalg.norm(between - between.swapaxes(-1, -2), axis=(-2, -1)) / (2 * math.sqrt(2))
    return float(np.arcsin(np.minimum(sine, 1)).max())


@pytest.mark.parametrize(
    ("scalar_type", "frame_bytes", "metres", "radians"),
    [(F32, 460, 0.0, 1e-6), (F16, 230, 0.001, 0.0015), (QUANTISED, 121, 0.0006, 0.0035)],
)
def test_sizes_and_errors_are_those_promised(scalar_type: int, frame_bytes: int, metres: float, radians: float) -> None:
    rows = walk(40)
    chunk = sent(rows, scalar_type, parts=3)
    assert len(chunk.data) == 40 * frame_bytes
    assert (chunk.frame_count, chunk.scalar_type) == (40, scalar_type)
    found = FrameReader(RIG, FORMATS[scalar_type]).rows(chunk)
    assert np.abs(found[:, :3] - rows[:, :3]).max() <= metres
    assert worst_angle_rad(found, rows) <= radians
    assert np.array_equal(found[:, -4:], rows[:, -4:])


@pytest.mark.parametrize("scalar_type", [F16, QUANTISED])
def test_rotation_signs_continue_from_frame_to_frame_and_chunk_to_chunk(scalar_type: int) -> None:
    rows, reader = walk(80), FrameReader(RIG, FORMATS[scalar_type])
    first = reader.rows(sent(rows[:33], scalar_type))
    second = reader.rows(sent(rows[33:], scalar_type), first[-1])
    turns = np.concatenate([first, second])[:, 3:-4].reshape(80, J, 4)
    assert (turns[1:] * turns[:-1]).sum(axis=-1).min() > 0.9


def test_chunk_of_another_size_origin_or_type_is_refused() -> None:
    chunk = sent(walk(3), F16)
    with pytest.raises(ProtocolViolation, match="a chunk has scalar type 2; F32"):
        FrameReader(RIG).rows(chunk)
    del chunk.root_origin_m[2]
    with pytest.raises(ProtocolViolation, match="an origin of 2 numbers"):
        FrameReader(RIG, FrameFormat.F16).rows(chunk)
    short = sent(walk(3), QUANTISED)
    short.data = short.data[:-1]
    with pytest.raises(ProtocolViolation, match="a chunk of 3 frames has 362 bytes, not the 363"):
        FrameReader(RIG, FrameFormat.QUANTISED).rows(short)


def test_unknown_scalar_type_is_refused() -> None:
    catalog = Catalog(FACTS, Limits(), Guidance(1.5, 2.5), "CC0-1.0", text_encoder="hashed-1", history_frames=16)
    opening = session_pb2.OpenSession(scalar_type=9)  # type: ignore[arg-type]
    with pytest.raises(EventRefused, match="9 is not offered") as refused:
        engine_event(session_pb2.SessionEvent(event_seq=1, open=opening), SessionKey(1, 1), 0.0, {}, catalog)
    assert (refused.value.reason, refused.value.field) == ("INVALID_SCALAR_TYPE", "open.scalar_type")


OUTPUTS = {
    "joint_velocities_mps": 3 * J,
    "joint_positions_m": 3 * J,
    "joint_global_rotation_quat_wxyz": 4 * J,
}


def walk_with_outputs(frames: int) -> np.ndarray:
    """The same with velocities up to 6 m/s, positions near the root, and the joints' rotations as global ones."""
    rows, generator = walk(frames), np.random.default_rng(4)
    speeds = generator.uniform(-6, 6, (frames, 3 * J))
    places = np.tile(rows[:, :3], J) + generator.uniform(-1, 1, (frames, 3 * J))
    return np.concatenate([rows, speeds, places, rows[:, 3 : 3 + 4 * J]], axis=1).astype(np.float32)


@pytest.mark.parametrize(
    ("scalar_type", "frame_bytes", "metres", "metres_a_second", "radians"),
    [
        (F32, 460 + 4 * 270, 0.0, 0.0, 1e-6),
        (F16, 230 + 2 * 270, 0.002, 0.002, 0.0015),
        (QUANTISED, 121 + 162 + 162 + 108, 0.0011, 0.0006, 0.0035),
    ],
)
def test_outputs_have_the_sizes_and_errors_promised(
    scalar_type: int, frame_bytes: int, metres: float, metres_a_second: float, radians: float
) -> None:
    rows, rig = walk_with_outputs(30), RIG.with_outputs(OUTPUTS)
    blocks = tuple(ChannelBlock(*output) for output in OUTPUTS.items())
    chunk = sent(rows, scalar_type, blocks=blocks)
    assert len(chunk.data) == 30 * frame_bytes
    found = Motion(rig, 8, FrameReader(rig, FORMATS[scalar_type]).rows(chunk))
    sent_as = Motion(rig, 8, rows)
    for name, most in (("joint_positions_m", metres), ("joint_velocities_mps", metres_a_second)):
        assert np.abs(found.output(name) - sent_as.output(name)).max() <= most, name
    assert worst_angle_rad(found.own().rows, sent_as.own().rows) <= radians
    turns = "joint_global_rotation_quat_wxyz"
    padding = np.zeros((30, 3)), np.zeros((30, 4))
    with_turns = [np.concatenate([padding[0], each.output(turns), padding[1]], axis=1) for each in (found, sent_as)]
    assert worst_angle_rad(*with_turns) <= radians
    signs = found.output(turns).reshape(30, J, 4)
    assert (signs[1:] * signs[:-1]).sum(axis=-1).min() > 0.9


def test_robots_root_far_away_is_as_exact_as_the_characters() -> None:
    blocks = (ChannelBlock("g1_qpos", 36),)
    rows = walk(10)
    qpos = np.concatenate(
        [rows[:, [2, 0, 1]], np.zeros((10, 33))], axis=1
    )  # the robot's forward, left, up are our z, x, y
    both = np.concatenate([rows, qpos], axis=1).astype(np.float32)
    chunk = sent(both, F16, blocks=blocks)
    rig = RIG.with_outputs({"g1_qpos": 36})
    found = Motion(rig, 8, FrameReader(rig, FrameFormat.F16).rows(chunk)).output("g1_qpos")
    assert np.abs(found[:, :3] - qpos[:, :3]).max() <= 0.001


@pytest.mark.parametrize("scalar_type", [F16, QUANTISED])
def test_velocities_beyond_the_formats_range_are_clamped(scalar_type: int) -> None:
    rows = walk(4)
    speeds = np.full((4, 3 * J), 400_000.0, np.float32)  # across the whole world in one frame
    chunk = sent(
        np.concatenate([rows, speeds], axis=1), scalar_type, blocks=(ChannelBlock("joint_velocities_mps", 3 * J),)
    )
    rig = RIG.with_outputs({"joint_velocities_mps": 3 * J})
    found = Motion(rig, 8, FrameReader(rig, FORMATS[scalar_type]).rows(chunk)).output("joint_velocities_mps")
    assert found.min() == found.max() == pytest.approx(65504.0 if scalar_type == F16 else 32.767)


@pytest.mark.parametrize("names", [["heart_rate"], ["joint_positions_m", "joint_positions_m"]])
def test_unknown_and_repeated_outputs_are_refused(names: list[str]) -> None:
    catalog = Catalog(FACTS, Limits(), Guidance(1.5, 2.5), "CC0-1.0", text_encoder="hashed-1", history_frames=16)
    opening = session_pb2.OpenSession(outputs=names)
    with pytest.raises(EventRefused, match=names[0]) as refused:
        engine_event(session_pb2.SessionEvent(event_seq=1, open=opening), SessionKey(1, 1), 0.0, {}, catalog)
    assert refused.value.reason == "UNKNOWN_OUTPUT"
    assert refused.value.field == f"open.outputs[{len(names) - 1}]"


def test_robot_output_cannot_be_quantised() -> None:
    facts = replace(FACTS, outputs=(ChannelBlock("g1_qpos", 36),))
    catalog = Catalog(facts, Limits(), Guidance(1.5, 2.5), "CC0-1.0", text_encoder="hashed-1", history_frames=16)
    opening = session_pb2.OpenSession(outputs=["g1_qpos"], scalar_type=motion_pb2.SCALAR_TYPE_QUANTISED)
    with pytest.raises(EventRefused, match="is not quantised") as refused:
        engine_event(session_pb2.SessionEvent(event_seq=1, open=opening), SessionKey(1, 1), 0.0, {}, catalog)
    assert (refused.value.reason, refused.value.field) == ("OUTPUT_NOT_QUANTISED", "open.outputs[0]")
