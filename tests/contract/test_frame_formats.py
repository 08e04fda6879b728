"""How frames are stored on their way: what the server writes the client reads, within the errors that are promised."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_client import FrameFormat, ProtocolViolation, Rig
from motiongen_client.convert import FrameReader
from motiongen_client.kinematics import quaternion_to_matrix
from motiongen_server.engine.types import EventRefused, Guidance, SessionKey
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import append_frames, engine_event
from motiongen_server.rpc.convert.frames import F16, F32, QUANTISED, FrameCoding
from motiongen_server.rpc.limits import Limits
from tests.server.engine.fakes import FACTS

J = 27
BLOCKS = {"root_translation_m": 3, "joint_rotation_quat_wxyz": 4 * J, "foot_contact": 4}
RIG = Rig(
    "r", tuple(f"j{n}" for n in range(J)), (-1, *range(J - 1)), np.zeros((J, 3), np.float32), 20, BLOCKS, None, {}
)
FORMATS = {F32: FrameFormat.F32, F16: FrameFormat.F16, QUANTISED: FrameFormat.QUANTISED}


def walk(frames: int) -> np.ndarray:
    """Rows of somebody who turns all joints evenly, each about an axis of its own, 400 m away from the origin."""
    generator, time = np.random.default_rng(3), np.arange(frames)[:, None] / 20
    axes = generator.normal(size=(J, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angle = (generator.uniform(-3, 3, J) + time * generator.uniform(-3, 3, J))[..., None]
    turns = np.concatenate([np.cos(angle), np.sin(angle) * axes], axis=-1)
    root = np.array([400.0, 0.9, -200.0]) + time * [1.0, 0.0, 0.5]
    contacts = generator.integers(0, 2, (frames, 4))
    return np.concatenate([root, turns.reshape(frames, -1), contacts], axis=1).astype(np.float32)


def sent(rows: np.ndarray, scalar_type: int, parts: int = 1) -> motion_pb2.FrameChunk:
    response: list[bytes | memoryview] = []
    append_frames(response, 1, 2, 3, 8, np.array_split(rows, parts), 4, FrameCoding(scalar_type, J))
    message = service_pb2.StreamMotionResponse.FromString(b"".join(response))
    return message.updates[0].chunk


def worst_angle_rad(one: np.ndarray, other: np.ndarray) -> float:
    first, second = (rows[:, 3:-4].reshape(len(rows), -1, 4).astype(np.float64) for rows in (one, other))
    between = quaternion_to_matrix(first).swapaxes(-1, -2) @ quaternion_to_matrix(second)
    sine = np.linalg.norm(between - between.swapaxes(-1, -2), axis=(-2, -1)) / (2 * math.sqrt(2))
    return float(np.arcsin(np.minimum(sine, 1)).max())


@pytest.mark.parametrize(
    ("scalar_type", "frame_bytes", "metres", "radians"),
    [(F32, 460, 0.0, 1e-6), (F16, 230, 0.001, 0.0015), (QUANTISED, 121, 0.0006, 0.0035)],
)
def test_errors_and_bytes_are_those_that_are_promised(
    scalar_type: int, frame_bytes: int, metres: float, radians: float
) -> None:
    rows = walk(40)
    chunk = sent(rows, scalar_type, parts=3)
    assert len(chunk.data) == 40 * frame_bytes
    assert (chunk.frame_count, chunk.scalar_type) == (40, scalar_type)
    found = FrameReader(RIG, FORMATS[scalar_type]).rows(chunk)
    assert np.abs(found[:, :3] - rows[:, :3]).max() <= metres
    assert worst_angle_rad(found, rows) <= radians
    assert np.array_equal(found[:, -4:], rows[:, -4:])


@pytest.mark.parametrize("scalar_type", [F16, QUANTISED])
def test_signs_go_on_from_frame_to_frame_and_from_chunk_to_chunk(scalar_type: int) -> None:
    rows, reader = walk(80), FrameReader(RIG, FORMATS[scalar_type])
    first = reader.rows(sent(rows[:33], scalar_type))
    second = reader.rows(sent(rows[33:], scalar_type), first[-1])
    turns = np.concatenate([first, second])[:, 3:-4].reshape(80, J, 4)
    assert (turns[1:] * turns[:-1]).sum(axis=-1).min() > 0.9


def test_a_chunk_of_another_size_origin_or_type_is_named() -> None:
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


def test_a_scalar_type_that_is_not_offered_is_refused_by_name() -> None:
    catalog = Catalog(FACTS, Limits(), Guidance(1.5, 2.5), "CC0-1.0", "hashed-1", history_frames=16)
    opening = session_pb2.OpenSession(scalar_type=9)  # type: ignore[arg-type]
    with pytest.raises(EventRefused, match="9 is not offered") as refused:
        engine_event(session_pb2.SessionEvent(event_seq=1, open=opening), SessionKey(1, 1), 0.0, {}, catalog)
    assert (refused.value.reason, refused.value.field) == ("INVALID_SCALAR_TYPE", "open.scalar_type")
