"""Encodes updates as the protocol's bytes.

Frames are encoded without building a message: a message would copy them in, and again when serialized, which was four
fifths of the cost of a chunk. So are plans, as there is one for every chunk or two. Everything else goes through its
message.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import Float32Array, PlanNotice
from motiongen_server.rpc.convert.frames import F32, FrameCoding

Parts: TypeAlias = list[Any]
"""Parts of one message, to be joined: bytes and arrays. (Arrays are buffers, but numpy's types do not say so.)"""

_VARINT, _LENGTH_DELIMITED = 0, 2


class FramesToSend(Protocol):
    """The content of an update with a FrameChunk.

    handle: of the session. parts: (T, row_width) each, consecutive frames, num_frames together.
    """

    handle: int
    applied_seq: int
    plan: int
    first_frame: int
    num_frames: int
    committed_to: int
    parts: list[Float32Array]


class _Varints(Protocol):
    """Encoded integers of 0 or more, seven bits per byte, lowest first (protobuf encoding, "Base 128 Varints")."""

    def __getitem__(self, number: int, /) -> bytes: ...


def _varint(number: int) -> bytes:
    encoded = bytearray()
    while number > 127:
        encoded.append(number & 127 | 128)
        number >>= 7
    encoded.append(number)
    return bytes(encoded)


_AT_HAND = [_varint(number) for number in range(1 << 16)]
"""Encoded beforehand: a chunk has nine numbers, and a look-up takes a tenth of the time of a call."""


class _AllVarints:
    """All integers: those beyond `_AT_HAND` are encoded when asked for."""

    def __getitem__(self, number: int) -> bytes:
        return _AT_HAND[number] if number < len(_AT_HAND) else _varint(number)


VARINT: _Varints = _AllVarints()


def _tag(message: Any, field: str, wire_type: int) -> bytes:
    """The tag of a message's field. message: its class."""
    return VARINT[message.DESCRIPTOR.fields_by_name[field].number << 3 | wire_type]


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
_AS_F32 = _SCALAR_TYPE + VARINT[F32]


def append_update(response: Parts, update: session_pb2.SessionUpdate) -> None:
    """Add an update to the parts of a StreamMotionResponse."""
    encoded = update.SerializeToString()
    response += (_UPDATES, VARINT[len(encoded)], encoded)


def append_frames(response: Parts, frames: FramesToSend, coding: FrameCoding) -> None:
    """Add an update with a FrameChunk, or several if one cannot hold all frames."""
    if coding.scalar_type == F32:
        parts = [np.ascontiguousarray(part, _F32_LE) for part in frames.parts]
        _append_chunk(response, frames, (0, frames.num_frames), _AS_F32, parts)
        return
    rows = np.concatenate(frames.parts) if len(frames.parts) > 1 else frames.parts[0]
    for begin, end in coding.stretches(rows):
        whole, stored = _coded(rows[begin:end], coding)
        _append_chunk(response, frames, (begin, end), stored, [whole])


def _append_chunk(
    response: Parts,
    frames: FramesToSend,
    stretch: tuple[int, int],
    stored: bytes,
    data: Sequence[Float32Array] | Sequence[memoryview],
) -> None:
    """Add an update with a FrameChunk of the frames in a stretch (begin, end).

    stored: the fields that say how the data is encoded.
    """
    num_bytes = sum(part.nbytes for part in data)
    try:
        response += _before_data(frames, stretch, stored, num_bytes, _AT_HAND)
    except IndexError:
        response += _before_data(frames, stretch, stored, num_bytes, VARINT)
    response += data


def _before_data(
    frames: FramesToSend, stretch: tuple[int, int], stored: bytes, num_bytes: int, number: _Varints
) -> tuple[bytes, ...]:
    """An update with a FrameChunk, up to its data of num_bytes. Raises IndexError for a number that `number` lacks."""
    begin, end = stretch
    chunk = b"".join(
        (
            _PLAN, number[frames.plan],
            _FIRST_FRAME, number[frames.first_frame + begin],
            _FRAME_COUNT, number[end - begin],
            _COMMITTED_TO, number[frames.committed_to],
            stored,
            _DATA, number[num_bytes],
        )
    )  # fmt: skip
    num_bytes += len(chunk)
    update = b"".join(
        (
            _SESSION, number[frames.handle],
            _APPLIED_SEQ, number[frames.applied_seq],
            _UPDATE_CHUNK, number[num_bytes],
        )
    )  # fmt: skip
    return _UPDATES, number[len(update) + num_bytes], update, chunk


def _coded(rows: Float32Array, coding: FrameCoding) -> tuple[memoryview, bytes]:
    """Encoded frames, and the fields that say how they are encoded."""
    whole, origin = coding.encode(rows)
    stored = _SCALAR_TYPE + VARINT[coding.scalar_type]
    if origin is not None:
        stored += _ORIGIN + VARINT[_ORIGIN_BYTES] + origin.astype(_F32_LE).tobytes()
    return whole, stored


def append_plan(response: Parts, applied_seq: int, notice: PlanNotice) -> None:
    """Add an update with a PlanNotice."""
    try:
        response += _plan(applied_seq, notice, _AT_HAND)
    except IndexError:
        response += _plan(applied_seq, notice, VARINT)


def _plan(applied_seq: int, notice: PlanNotice, number: _Varints) -> tuple[bytes, ...]:
    """An update with a PlanNotice. Raises IndexError for a number that `number` lacks."""
    plan = b"".join(
        (
            _NOTICE_PLAN, number[notice.plan],
            _VALID_FROM, number[notice.valid_from],
            _CAUSE, number[notice.cause],  # the engine's numbers are the protocol's
        )
    )  # fmt: skip
    if notice.event_seqs:
        seqs = b"".join([number[seq] for seq in notice.event_seqs])
        plan += _EVENT_SEQS + number[len(seqs)] + seqs
    session = notice.session.handle
    update = b"".join((_SESSION, number[session], _APPLIED_SEQ, number[applied_seq], _UPDATE_PLAN, number[len(plan)]))
    return _UPDATES, number[len(update) + len(plan)], update, plan
