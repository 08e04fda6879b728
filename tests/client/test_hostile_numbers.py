"""Numbers and orders of messages that no valid server sends: each is reported as a protocol violation."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import grpc
import numpy as np
import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_client import (
    MotionClient,
    Playback,
    ProtocolViolation,
    Session,
    SessionEnded,
    convert,
)
from motiongen_client.convert.frames import FrameReader
from motiongen_client.playback import MOST_AHEAD_BYTES, MOST_CUTS_AHEAD
from motiongen_client.types import FrameFormat
from tests.client.fake_server import FakeServer, FakeStream
from tests.client.synthetic import HORIZON, ROW_WIDTH, catalog, rig
from tests.client.waiting import until

HUGE = 2**64 - 1
Say = Callable[[FakeStream, session_pb2.SessionEvent], None]


def opened(**more: object) -> session_pb2.SessionOpened:
    return session_pb2.SessionOpened(rig_id="stick9", model_id="synthetic", **more)  # type: ignore[arg-type]


def start_frame_too_large(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(event.session, opened=opened(start_frame=HUGE))


def placement_frame_too_large(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    placement = motion_pb2.ConstraintPlacement(constraint_id=1, anchor_frame=HUGE)
    stream.push(event.session, opened=opened(placements=[placement]))


def service_level_before_opening(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(event.session, service_level=session_pb2.ServiceLevel(denoise_steps=2))


def opened_twice(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(event.session, opened=opened())
    stream.push(event.session, opened=opened())


@pytest.mark.parametrize(
    "say",
    [start_frame_too_large, placement_frame_too_large, service_level_before_opening],
    ids=lambda say: say.__name__,
)
async def test_invalid_answer_to_an_open_raises_protocol_violation_in_open(
    client: MotionClient, server: FakeServer, say: Say
) -> None:
    def answer(event: session_pb2.SessionEvent) -> session_pb2.EditOutcome:
        say(server.stream, event)
        return session_pb2.EditOutcome()  # in addition to the message: accepted

    server.refuse = answer
    with pytest.raises(ProtocolViolation):
        await client.open("walk")


def plan_frame_too_large(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(1, plan=session_pb2.PlanNotice(plan=1000, valid_from=HUGE))


def effective_frame_too_large(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(1, outcome=session_pb2.EditOutcome(event_seq=event.event_seq, effective_frame=HUGE))


def reached_frame_too_large(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(1, constraint_reached=session_pb2.ConstraintReached(constraint_id=1, frame=HUGE))


def committed_frame_too_large(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    told = stream.characters[1]
    data = bytes(4 * ROW_WIDTH)
    chunk = motion_pb2.FrameChunk(plan=told.plan, first_frame=told.sent_to, frame_count=1, committed_to=HUGE, data=data)
    chunk.scalar_type = motion_pb2.SCALAR_TYPE_F32_LE
    stream.push(1, chunk=chunk)


@pytest.mark.parametrize(
    "say",
    [plan_frame_too_large, effective_frame_too_large, reached_frame_too_large, committed_frame_too_large, opened_twice],
    ids=lambda say: say.__name__,
)
async def test_invalid_update_ends_the_session_with_protocol_violation(
    client: MotionClient, server: FakeServer, say: Say
) -> None:
    session = await client.open("walk")

    def answer(event: session_pb2.SessionEvent) -> str:
        if event.HasField("set_velocity"):
            say(server.stream, event)
        return ""

    server.refuse = answer
    session.set_velocity(0, 1)
    with pytest.raises(ProtocolViolation):
        await session.constraint_reached(7)


async def test_unexpected_exception_ends_the_stream_without_reconnection(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = await client.open("walk")

    def fail(self: Session, update: session_pb2.SessionUpdate) -> None:
        raise IndexError("list index out of range")

    monkeypatch.setattr(Session, "hear", fail)
    server.stream.push(1, durability=session_pb2.SessionDurability())
    with pytest.raises(ProtocolViolation, match="list index out of range"):
        await session.constraint_reached(7)
    assert len(server.streams) == 1


async def test_session_whose_rig_is_gone_after_reconnection_ends_but_not_its_stream(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = await client.open("walk")
    other = catalog(100)
    other.rigs[0].rig_id = other.models[0].rig_id = "another"
    monkeypatch.setattr("tests.client.fake_server.catalog", lambda frame_rate: other)
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)
    with pytest.raises(SessionEnded, match="stick9"):
        await session.constraint_reached(7)
    assert client._own_stream is not None
    assert not client._own_stream.is_over


@pytest.mark.parametrize("patch_frames", [1, 4, 2**32 - 1])
async def test_history_of_a_reopened_session_is_cut_to_fit_one_message(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch, patch_frames: int
) -> None:
    session = await client.open("walk")
    await until(lambda: session.playback.buffered_to > 8)
    other = catalog(100)
    other.models[0].default_history_frames, other.models[0].patch_frames = 2**32 - 1, patch_frames
    monkeypatch.setattr("tests.client.fake_server.catalog", lambda frame_rate: other)
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)
    await until(lambda: session.reopenings)
    (opening,) = [event.open for event in server.stream.received if event.HasField("open")]
    assert 1 <= opening.prior_frames.frame_count <= other.limits.max_request_bytes // (4 * ROW_WIDTH)


# ---- catalogues


def test_rig_with_too_wide_rows_or_no_joints_is_a_protocol_violation() -> None:
    message = rig(20)
    message.blocks.add(name="wide", width=2**31)
    with pytest.raises(ProtocolViolation, match="9 joints in rows of"):
        convert.rig(message)
    nobody = [motion_pb2.ChannelBlock(name=block.name, width=block.width % 36) for block in rig(20).blocks]
    with pytest.raises(ProtocolViolation, match="0 joints"):
        convert.rig(motion_pb2.Rig(blocks=nobody, frame_rate=20))


def test_rig_with_offsets_that_are_not_finite_is_a_protocol_violation() -> None:
    message = rig(20)
    message.neutral_offsets_m[4] = float("inf")
    with pytest.raises(ProtocolViolation, match="not finite"):
        convert.rig(message)


@pytest.mark.parametrize(
    ("name", "width", "fits"),
    [
        ("joint_positions_m", 27, True),
        ("joint_positions_m", 28, False),
        ("joint_global_rotation_quat_wxyz", 35, False),
        ("g1_qpos", 1, False),
        ("of_a_later_version", 1, True),
        ("of_a_later_version", 2**20, False),
    ],
)
def test_output_of_a_wrong_width_is_a_protocol_violation(name: str, width: int, fits: bool) -> None:
    stick = convert.rig(rig(20))
    if fits:
        convert.check_outputs({name: width}, [name], stick)
        return
    with pytest.raises(ProtocolViolation, match=r"width|wider"):
        convert.check_outputs({name: width}, [name], stick)


def test_max_request_bytes_of_a_server_is_capped_at_8_mib() -> None:
    message = catalog(20)
    message.limits.max_request_bytes = 2**32 - 1
    assert convert.catalog(message).limits.max_request_bytes == 8 * 1024 * 1024


def test_only_the_first_three_other_servers_are_read() -> None:
    named = [session_pb2.OtherServer(routing_key=str(number)) for number in range(1000)]
    assert [each.routing_key for each in convert.other_servers(named)] == ["0", "1", "2"]


# ---- memory


def test_frames_beyond_the_look_ahead_memory_are_a_protocol_violation() -> None:
    playback = Playback(20, 2)
    playback.announce_plan(1, 0)
    most = MOST_AHEAD_BYTES // 8
    too_many = np.broadcast_to(np.zeros(2, np.float32), (most + 1, 2))
    with pytest.raises(ProtocolViolation, match="held ahead"):
        playback.add_chunk(1, 0, too_many, 0)
    playback.add_chunk(1, 0, np.zeros((4, 2), np.float32), 0)


def test_more_than_64_cuts_ahead_are_a_protocol_violation() -> None:
    playback = Playback(20, 2)
    for plan in range(1, MOST_CUTS_AHEAD + 1):
        playback.announce_plan(plan, 100 + plan, is_cut=True)
    with pytest.raises(ProtocolViolation, match="64 cuts"):
        playback.announce_plan(65, 1000, is_cut=True)
    playback.announce_plan(65, 110, is_cut=True)  # it replaces those behind it
    assert playback.is_cut(109)
    assert not playback.is_cut(111)
    assert playback.cut_before(110) == 109
    assert playback.cut_before(101) is None


def test_chunk_that_would_unpack_to_too_many_bytes_is_a_protocol_violation() -> None:
    message = rig(20)
    message.blocks.add(name="wide", width=16_000)  # which a quantised frame does not contain
    reader = FrameReader(convert.rig(message), FrameFormat.QUANTISED)
    count = 10_000
    chunk = motion_pb2.FrameChunk(frame_count=count, data=bytes(count * reader.row_bytes))
    chunk.scalar_type = motion_pb2.SCALAR_TYPE_QUANTISED
    with pytest.raises(ProtocolViolation, match="more than are held"):
        reader.rows(chunk)


# ---- clips

Part = service_pb2.GenerateClipResponse


def chunk_of(first_frame: int, count: int) -> Part:
    frames = motion_pb2.FrameChunk(first_frame=first_frame, frame_count=count, data=bytes(4 * ROW_WIDTH * count))
    frames.scalar_type = motion_pb2.SCALAR_TYPE_F32_LE
    return Part(chunk=frames)


def summary_of(*residuals: service_pb2.ConstraintResidual) -> Part:
    return Part(summary=service_pb2.ClipSummary(residuals=residuals))


OPENED = Part(opened=opened())
WRONG = {
    "before it was opened": [chunk_of(0, 4)],
    "opened twice": [OPENED, OPENED, chunk_of(4, 4)],
    "8 were asked for": [OPENED, *(chunk_of(first, 4) for first in range(0, 4 * HORIZON, 4))],
    "after its summary": [OPENED, chunk_of(0, 8), summary_of(), chunk_of(8, 4)],
    "1 residuals came for 0 constraints": [OPENED, chunk_of(0, 8), summary_of(service_pb2.ConstraintResidual())],
    "g1_qpos": [Part(opened=opened(outputs=[motion_pb2.ChannelBlock(name="g1_qpos", width=36)]))],
}


class Clips(FakeServer):
    """A server that sends these parts of a clip, and then empty ones until the call ends."""

    def __init__(self, parts: list[Part]) -> None:
        super().__init__()
        self.parts = parts
        self.gone = threading.Event()

    def GetCatalog(
        self, request: service_pb2.GetCatalogRequest, context: grpc.ServicerContext
    ) -> service_pb2.GetCatalogResponse:
        offered = catalog(self.frame_rate)
        offered.limits.max_clip_frames, offered.limits.max_clip_samples = HORIZON, 1
        return offered

    def GenerateClip(
        self, request: service_pb2.GenerateClipRequest, context: grpc.ServicerContext
    ) -> Iterator[service_pb2.GenerateClipResponse]:
        context.add_callback(self.gone.set)
        yield from self.parts
        while not self.gone.is_set():
            yield Part()


@pytest.mark.parametrize("reason", WRONG)
async def test_invalid_clip_raises_protocol_violation_and_ends_the_call(reason: str) -> None:
    with Clips(WRONG[reason]) as server:
        async with MotionClient(server.address) as client:
            with pytest.raises(ProtocolViolation, match=reason):
                await client.generate_clip("walk", num_frames=8)
            await until(lambda: server.gone.is_set())
