"""The bytes written for updates: protobuf parses them as the messages they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import Chunk, PlanCause, PlanNotice, SessionKey
from motiongen_server.rpc.convert import Parts, append_frames, append_plan, append_update
from motiongen_server.rpc.convert.frames import PLAIN
from motiongen_server.rpc.convert.wire import VARINT
from motiongen_server.rpc.send_queue import Run

uint32 = st.integers(0, 2**32 - 1)
uint64 = st.one_of(st.integers(0, 300), st.integers(0, 2**64 - 1))


def read(parts: Parts) -> service_pb2.StreamMotionResponse:
    return service_pb2.StreamMotionResponse.FromString(b"".join(parts))


@given(uint32, uint64, uint32, uint64, uint64, st.lists(st.integers(1, 50), min_size=1, max_size=4))
def test_bytes_of_frames_parse_as_the_intended_message(
    session: int, applied_seq: int, plan: int, first_frame: int, committed_to: int, counts: list[int]
) -> None:
    rows = np.arange(sum(counts) * 115, dtype=np.float32).reshape(-1, 115)
    parts = np.split(rows, np.cumsum(counts)[:-1])
    response: Parts = []
    run = Run(Chunk(SessionKey(1, session), plan, first_frame, rows, committed_to), applied_seq, None)
    run.parts = parts
    append_frames(response, run, PLAIN)
    chunk = motion_pb2.FrameChunk(
        plan=plan,
        first_frame=first_frame,
        frame_count=len(rows),
        committed_to=committed_to,
        data=rows.astype("<f4").tobytes(),
        scalar_type=motion_pb2.SCALAR_TYPE_F32_LE,
    )
    update = session_pb2.SessionUpdate(session=session, applied_seq=applied_seq, chunk=chunk)
    assert read(response) == service_pb2.StreamMotionResponse(updates=[update])


@given(uint32, uint64, uint32, uint64, st.sampled_from(PlanCause), st.lists(uint64, max_size=4))
def test_bytes_of_plans_parse_as_the_intended_message(
    session: int, applied_seq: int, plan: int, valid_from: int, cause: PlanCause, event_seqs: list[int]
) -> None:
    response: Parts = []
    append_plan(response, applied_seq, PlanNotice(SessionKey(1, session), plan, valid_from, cause, tuple(event_seqs)))
    notice = session_pb2.PlanNotice(plan=plan, valid_from=valid_from, event_seqs=event_seqs)
    notice.cause = session_pb2.PlanCause.Value(f"PLAN_CAUSE_{cause.name}")
    update = session_pb2.SessionUpdate(session=session, applied_seq=applied_seq, plan=notice)
    assert read(response) == service_pb2.StreamMotionResponse(updates=[update])


def test_updates_written_by_hand_and_by_protobuf_can_follow_each_other() -> None:
    notice = session_pb2.SessionUpdate(session=1, plan=session_pb2.PlanNotice(plan=3, valid_from=8, event_seqs=[2]))
    response: Parts = []
    append_update(response, notice)
    append_frames(response, Run(Chunk(SessionKey(1, 1), 3, 8, np.ones((2, 3), np.float32), 4), 2, None), PLAIN)
    append_update(response, session_pb2.SessionUpdate())
    told = read(response).updates
    assert [update.WhichOneof("update") for update in told] == ["plan", "chunk", None]
    assert told[0] == notice


def test_non_contiguous_rows_are_sent_in_their_order() -> None:
    rows = np.arange(12, dtype=np.float32).reshape(2, 6)[:, ::-1]
    response: Parts = []
    append_frames(response, Run(Chunk(SessionKey(1, 1), 1, 0, rows, 0), 0, None), PLAIN)
    (update,) = read(response).updates
    np.testing.assert_array_equal(np.frombuffer(update.chunk.data, "<f4").reshape(2, 6), rows)


@pytest.mark.parametrize(
    ("number", "encoded"),
    [
        (0, "00"),
        (1, "01"),
        (127, "7f"),
        (128, "8001"),
        (300, "ac02"),
        (16383, "ff7f"),
        (16384, "808001"),
        (65535, "ffff03"),
        (65536, "808004"),
        (2**28 - 1, "ffffff7f"),
        (2**28, "8080808001"),
        (2**64 - 1, "ffffffffffffffffff01"),
    ],
)
def test_varints_hold_seven_bits_a_byte(number: int, encoded: str) -> None:
    assert VARINT[number].hex() == encoded
