"""Numbers and orders of a server that no honest one says: each is told as the breach of the protocol that it is."""

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


def at_no_frame(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(event.session, opened=opened(start_frame=HUGE))


def placed_at_no_frame(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    placement = motion_pb2.ConstraintPlacement(constraint_id=1, anchor_frame=HUGE)
    stream.push(event.session, opened=opened(placements=[placement]))


def level_first(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(event.session, service_level=session_pb2.ServiceLevel(denoise_steps=2))


def twice(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(event.session, opened=opened())
    stream.push(event.session, opened=opened())


@pytest.mark.parametrize("say", [at_no_frame, placed_at_no_frame, level_first], ids=lambda say: say.__name__)
async def test_an_opening_that_breaks_a_rule_is_told_to_who_opens(
    client: MotionClient, server: FakeServer, say: Say
) -> None:
    def answer(event: session_pb2.SessionEvent) -> session_pb2.EditOutcome:
        say(server.stream, event)
        return session_pb2.EditOutcome()  # beside it: taken

    server.refuse = answer
    with pytest.raises(ProtocolViolation):
        await client.open("walk")


def plan_of_no_frame(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(1, plan=session_pb2.PlanNotice(plan=1000, valid_from=HUGE))


def edit_at_no_frame(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(1, outcome=session_pb2.EditOutcome(event_seq=event.event_seq, effective_frame=HUGE))


def reached_at_no_frame(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    stream.push(1, constraint_reached=session_pb2.ConstraintReached(constraint_id=1, frame=HUGE))


def committed_to_no_frame(stream: FakeStream, event: session_pb2.SessionEvent) -> None:
    told = stream.characters[1]
    data = bytes(4 * ROW_WIDTH)
    chunk = motion_pb2.FrameChunk(plan=told.plan, first_frame=told.sent_to, frame_count=1, committed_to=HUGE, data=data)
    chunk.scalar_type = motion_pb2.SCALAR_TYPE_F32_LE
    stream.push(1, chunk=chunk)


@pytest.mark.parametrize(
    "say",
    [plan_of_no_frame, edit_at_no_frame, reached_at_no_frame, committed_to_no_frame, twice],
    ids=lambda say: say.__name__,
)
async def test_what_breaks_a_rule_ends_the_stream_and_is_told(
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


async def test_what_nobody_thought_of_is_told_and_not_taken_for_a_loss(
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


async def test_a_server_that_comes_back_without_the_rig_ends_the_session_alone(
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
async def test_a_history_that_no_message_holds_is_cut_to_what_one_does(
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


# ---- what a catalogue says


def test_a_rig_of_rows_wider_than_any_skeleton_is_not_taken() -> None:
    message = rig(20)
    message.blocks.add(name="wide", width=2**31)
    with pytest.raises(ProtocolViolation, match="9 joints in rows of"):
        convert.rig(message)
    nobody = [motion_pb2.ChannelBlock(name=block.name, width=block.width % 36) for block in rig(20).blocks]
    with pytest.raises(ProtocolViolation, match="0 joints"):
        convert.rig(motion_pb2.Rig(blocks=nobody, frame_rate=20))


def test_offsets_that_are_not_finite_are_not_taken() -> None:
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
def test_outputs_are_as_wide_as_their_names_say(name: str, width: int, fits: bool) -> None:
    stick = convert.rig(rig(20))
    if fits:
        convert.check_outputs({name: width}, [name], stick)
        return
    with pytest.raises(ProtocolViolation, match=r"width|wider"):
        convert.check_outputs({name: width}, [name], stick)


def test_no_limit_is_taken_for_more_than_is_ever_put_together() -> None:
    message = catalog(20)
    message.limits.max_request_bytes = 2**32 - 1
    assert convert.catalog(message).limits.max_request_bytes == 8 * 1024 * 1024


def test_as_many_other_servers_are_asked_as_the_contract_has() -> None:
    named = [session_pb2.OtherServer(routing_key=str(number)) for number in range(1000)]
    assert [each.routing_key for each in convert.other_servers(named)] == ["0", "1", "2"]


# ---- what takes memory


def test_no_more_is_held_ahead_than_there_is_memory_for() -> None:
    playback = Playback(20, 2)
    playback.announce_plan(1, 0)
    most = MOST_AHEAD_BYTES // 8
    too_many = np.broadcast_to(np.zeros(2, np.float32), (most + 1, 2))
    with pytest.raises(ProtocolViolation, match="held ahead"):
        playback.add_chunk(1, 0, too_many, 0)
    playback.add_chunk(1, 0, np.zeros((4, 2), np.float32), 0)


def test_no_more_cuts_are_announced_ahead_than_anyone_makes() -> None:
    playback = Playback(20, 2)
    for plan in range(1, MOST_CUTS_AHEAD + 1):
        playback.announce_plan(plan, 100 + plan, is_cut=True)
    with pytest.raises(ProtocolViolation, match="64 cuts"):
        playback.announce_plan(65, 1000, is_cut=True)
    playback.announce_plan(65, 110, is_cut=True)  # it takes the place of those behind it
    assert playback.is_cut(109)
    assert not playback.is_cut(111)
    assert playback.cut_before(110) == 109
    assert playback.cut_before(101) is None


def test_a_chunk_that_unpacks_to_more_than_is_held_is_not_unpacked() -> None:
    message = rig(20)
    message.blocks.add(name="wide", width=16_000)  # of which a quantised frame says nothing
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


OPENED, SUMMARY = Part(opened=opened()), Part(summary=service_pb2.ClipSummary())
WRONG = {
    "a chunk first": [chunk_of(0, 4)],
    "frames without end": [OPENED, *(chunk_of(first, 4) for first in range(0, 4 * HORIZON, 4))],
    "frames behind the summary": [OPENED, chunk_of(0, 8), SUMMARY, chunk_of(8, 4)],
    "other outputs": [Part(opened=opened(outputs=[motion_pb2.ChannelBlock(name="g1_qpos", width=36)]))],
}


class Clips(FakeServer):
    """A server that says these parts of a clip, and sends on for as long as somebody listens."""

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


@pytest.mark.parametrize("parts", WRONG.values(), ids=WRONG)
async def test_a_clip_that_breaks_a_rule_is_refused_and_its_call_ended(parts: list[Part]) -> None:
    with Clips(parts) as server:
        async with MotionClient(server.address) as client:
            with pytest.raises(ProtocolViolation):
                await client.generate_clip("walk", num_frames=8)
            await until(lambda: server.gone.is_set())
