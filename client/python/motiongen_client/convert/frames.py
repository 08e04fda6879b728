"""Frames, from the bytes of a chunk."""

from __future__ import annotations

import numpy as np

from motiongen.v1 import motion_pb2
from motiongen_client.errors import ProtocolViolation
from motiongen_client.motion import Float32


def chunk_rows(message: motion_pb2.FrameChunk, row_width: int) -> Float32:
    """(T, row_width) float32, read-only. Raises ProtocolViolation when the bytes are not that many rows."""
    if message.scalar_type != motion_pb2.SCALAR_TYPE_F32_LE:
        raise ProtocolViolation(f"a chunk has scalar type {message.scalar_type}; F32_LE was asked for")
    expected = message.frame_count * row_width * 4
    if message.frame_count < 1 or len(message.data) != expected:
        raise ProtocolViolation(
            f"a chunk of {message.frame_count} frames has {len(message.data)} bytes, not the {expected} of its rig"
        )
    rows = np.frombuffer(message.data, dtype="<f4").reshape(message.frame_count, row_width)
    return rows.astype(np.float32, copy=False)
