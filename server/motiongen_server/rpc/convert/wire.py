"""Updates as the protocol's bytes.

Frames are written without building a message of them: a message copies them in, and again when it is serialized, which
was four fifths of what a chunk cost. So are plans, which there is one of for every chunk or two. Everything else goes
through its message.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import Float32Array, PlanNotice
from motiongen_server.rpc.convert.frames import F32, FrameCoding

Parts: TypeAlias = list[bytes | memoryview]
"""Of one message; to be joined."""

_VARINT, _LENGTH_DELIMITED = 0, 2


def varint(number: int) -> bytes:
    """A whole number of 0 or more, seven bits a byte, the lowest first (protobuf encoding, "Base 128 Varints")."""
    if number < _NUM_SHORT:
        return _SHORT[number]
    return _CONTINUED[number % _NUM_SHORT] + varint(number // _NUM_SHORT)


def _tag(message: Any, field: str, wire_type: int) -> bytes:
    """Of a field of a message's class."""
    return varint(message.DESCRIPTOR.fields_by_name[field].number << 3 | wire_type)


_SHORT = [bytes([number]) for number in range(128)]
_SHORT += [bytes([number & 127 | 128, number >> 7]) for number in range(128, 1 << 14)]
_NUM_SHORT = len(_SHORT)
_CONTINUED = [bytes([number & 127 | 128, number >> 7 | 128]) for number in range(_NUM_SHORT)]

_UPDATES = _tag(service_pb2.StreamMotionResponse, "updates", _LENGTH_DELIMITED)
_SESSION = _tag(session_pb2.SessionUpdate, "session", _VARINT)
_APPLIED_SEQ = _tag(session_pb2.SessionUpdate, "applied_seq", _VARINT)
_UPDATE_PLAN = _tag(session_pb2.SessionUpdate, "plan", _LENGTH_DELIMITED)
_UPDATE_CHUNK = _tag(session_pb2.SessionUpdate, "chunk", _LENGTH_DELIMITED)
_NOTICE_PLAN = _tag(session_pb2.PlanNotice, "plan", _VARINT)
_VALID_FROM = _tag(session_pb2.PlanNotice, "valid_from", _VARINT)
_CAUSE = _tag(session_pb2.PlanNotice, "cause", _VARINT)
_EVENT_SEQS = _tag(session_pb2.PlanNotice, "event_seqs", _LENGTH_DELIMITED)  # packed
_PLAN = _tag(motion_pb2.FrameChunk, "plan", _VARINT)
_FIRST_FRAME = _tag(motion_pb2.FrameChunk, "first_frame", _VARINT)
_FRAME_COUNT = _tag(motion_pb2.FrameChunk, "frame_count", _VARINT)
_COMMITTED_TO = _tag(motion_pb2.FrameChunk, "committed_to", _VARINT)
_SCALAR_TYPE = _tag(motion_pb2.FrameChunk, "scalar_type", _VARINT)
_ORIGIN = _tag(motion_pb2.FrameChunk, "root_origin_m", _LENGTH_DELIMITED)  # packed
_DATA = _tag(motion_pb2.FrameChunk, "data", _LENGTH_DELIMITED)
_ORIGIN_BYTES = 12

_F32_LE = np.dtype("<f4")


def append_update(response: Parts, update: session_pb2.SessionUpdate) -> None:
    """Add an update to the parts of a StreamMotionResponse."""
    encoded = update.SerializeToString()
    response += (_UPDATES, varint(len(encoded)), encoded)


def append_frames(
    response: Parts,
    session: int,
    applied_seq: int,
    plan: int,
    first_frame: int,
    parts: Sequence[Float32Array],
    committed_to: int,
    coding: FrameCoding,
) -> None:
    """Add an update with a FrameChunk. parts: (T, row_width) each, consecutive frames one after another."""
    num_frames = sum(map(len, parts))
    origin: Float32Array | None = None
    if coding.scalar_type == F32:
        data = [np.ascontiguousarray(part, _F32_LE).data for part in parts]
    else:
        whole, origin = coding.encode(np.concatenate(parts) if len(parts) > 1 else parts[0])
        data = [whole]
    num_bytes = sum(part.nbytes for part in data)
    chunk = b"".join(
        (
            _PLAN, varint(plan),
            _FIRST_FRAME, varint(first_frame),
            _FRAME_COUNT, varint(num_frames),
            _COMMITTED_TO, varint(committed_to),
            _SCALAR_TYPE, varint(coding.scalar_type),
            *(() if origin is None else (_ORIGIN, varint(_ORIGIN_BYTES), origin.astype(_F32_LE).tobytes())),
            _DATA, varint(num_bytes),
        )
    )  # fmt: skip
    num_bytes += len(chunk)
    update = b"".join((_SESSION, varint(session), _APPLIED_SEQ, varint(applied_seq), _UPDATE_CHUNK, varint(num_bytes)))
    response += (_UPDATES, varint(len(update) + num_bytes), update, chunk)
    response += data


def append_plan(response: Parts, applied_seq: int, notice: PlanNotice) -> None:
    """Add an update with a PlanNotice."""
    plan = b"".join(
        (
            _NOTICE_PLAN, varint(notice.plan),
            _VALID_FROM, varint(notice.valid_from),
            _CAUSE, varint(notice.cause),  # the engine's numbers are the protocol's
        )
    )  # fmt: skip
    if notice.event_seqs:
        seqs = b"".join(map(varint, notice.event_seqs))
        plan += _EVENT_SEQS + varint(len(seqs)) + seqs
    session = notice.session.handle
    update = b"".join((_SESSION, varint(session), _APPLIED_SEQ, varint(applied_seq), _UPDATE_PLAN, varint(len(plan))))
    response += (_UPDATES, varint(len(update) + len(plan)), update, plan)
