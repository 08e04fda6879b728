"""GenerateClip over gRPC: what a client asks for and gets, what is refused, and what stops the work."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field

import grpc.aio
import numpy as np
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import WindowJob
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.limits import Limits, PeerLimits
from tests.contract.local import LocalServer
from tests.logged import errors
from tests.server.engine.fakes import FRAME, PROMPT, ROW_WIDTH, SEED
from tests.waiting import LIMIT_S, until_true


@dataclass
class Sample:
    """What was received of one sample."""

    opened: session_pb2.SessionOpened | None = None
    rows: list[np.ndarray] = field(default_factory=list)
    summary: service_pb2.ClipSummary | None = None

    def add(self, response: service_pb2.GenerateClipResponse) -> None:
        part = response.WhichOneof("part")
        assert self.summary is None, "nothing comes after the summary"
        if part == "opened":
            assert self.opened is None
            self.opened = response.opened
        elif part == "chunk":
            assert self.opened is not None
            assert response.chunk.first_frame == len(self.rows)
            self.rows += list(np.frombuffer(response.chunk.data, "<f4").reshape(-1, ROW_WIDTH))
        else:
            self.summary = response.summary


async def generate(
    server: LocalServer, request: service_pb2.GenerateClipRequest, timeout_s: float | None = LIMIT_S
) -> dict[int, Sample]:
    samples: dict[int, Sample] = {}
    async with grpc.aio.insecure_channel(server.address) as channel:
        async for response in MotionServiceStub(channel).GenerateClip(request, timeout=timeout_s):
            samples.setdefault(response.sample, Sample()).add(response)
    return samples


async def refusal(
    server: LocalServer, request: service_pb2.GenerateClipRequest, timeout_s: float | None = LIMIT_S
) -> tuple[grpc.StatusCode, error_details_pb2.ErrorInfo, str]:
    """The status, its reason, and the field at fault."""
    with pytest.raises(grpc.aio.AioRpcError) as failure:
        await generate(server, request, timeout_s)
    status = rpc_status.from_call(failure.value)
    info, bad = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest()
    for detail in status.details if status is not None else ():
        detail.Unpack(info) or detail.Unpack(bad)
    return failure.value.code(), info, bad.field_violations[0].field if bad.field_violations else ""


def clip(num_frames: int = 60, samples: int = 0, **opening: object) -> service_pb2.GenerateClipRequest:
    return service_pb2.GenerateClipRequest(
        open=session_pb2.OpenSession(**opening),  # type: ignore[arg-type]
        frame_count=num_frames,
        sample_count=samples,
    )


def waypoint(frame: int, x: float = 0.0, z: float = 1.0, constraint_id: int = 1) -> motion_pb2.Constraint:
    return motion_pb2.Constraint(constraint_id=constraint_id, frame=frame, waypoint=motion_pb2.Waypoint(x=x, z=z))


@pytest.fixture
async def server() -> AsyncIterator[LocalServer]:
    async with asyncio.timeout(LIMIT_S), LocalServer() as local:
        yield local


async def test_every_sample_is_complete_and_has_its_own_seed(server: LocalServer) -> None:
    samples = await generate(server, clip(90, 3, seed=2**64 - 1, denoise_steps=5))
    assert sorted(samples) == [0, 1, 2]
    for number, sample in samples.items():
        assert sample.opened is not None
        assert sample.summary is not None
        assert sample.opened.seed == (2**64 - 1 + number) % 2**64, "seeds wrap around"
        assert (sample.opened.denoise_steps, sample.opened.rig_id, sample.opened.lookahead_frames) == (5, "fake", 0)
        assert [int(row[FRAME]) for row in sample.rows] == list(range(90))
    assert {int(row[SEED]) for row in samples[1].rows} == {0}
    assert {job.num_steps for job in server.runner.prepared} == {5}
    assert {job.background for job in server.runner.prepared} == {True}


async def test_each_call_asks_the_encoder_in_the_name_of_its_caller(
    server: LocalServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    askers, encode = [], server.prompts.encode_all
    monkeypatch.setattr(server.prompts, "encode_all", lambda texts, asker: askers.append(asker) or encode(texts, asker))
    for text in ("walk", "run"):
        await generate(server, clip(prompts=[motion_pb2.PromptSpan(prompt_id=1, text=text)]))
    assert {asker.peer for asker in askers} == {"ipv4:127.0.0.1"}
    assert len({asker.number for asker in askers}) == 2


async def test_prompts_of_a_clip_are_in_force_for_their_frames(server: LocalServer) -> None:
    spans = [
        motion_pb2.PromptSpan(prompt_id=1, text="walk", end_frame=50),
        motion_pb2.PromptSpan(prompt_id=2, text="runs", start_frame=50),
    ]
    spans[1].text = "run faster"
    samples = await generate(server, clip(80, prompts=spans))
    assert [int(row[PROMPT]) for row in samples[0].rows] == [len("walk")] * 50 + [len("run faster")] * 30


async def test_clip_continues_prior_frames_with_the_requested_history(server: LocalServer) -> None:
    rows = np.zeros((24, ROW_WIDTH), "<f4")
    rows[:, FRAME] = np.arange(-24, 0)
    rows[:, 3] = 1.005  # a quaternion that is almost one
    prior = motion_pb2.FrameChunk(frame_count=24, data=rows.tobytes())
    samples = await generate(server, clip(60, prior_frames=prior, history_frames=20))
    assert len(samples[0].rows) == 60
    assert [len(job.history) for job in server.runner.prepared] == [20, 20]
    assert server.runner.prepared[0].start_pose is None


def prior_frames(**changes: object) -> dict[str, object]:
    rows = np.zeros((4, ROW_WIDTH), "<f4")
    rows[:, 3] = 1.0
    return {"prior_frames": motion_pb2.FrameChunk(**{"frame_count": 4, "data": rows.tobytes(), **changes})}  # type: ignore[arg-type]


def spoiled(column: int, value: float) -> dict[str, object]:
    rows = np.zeros((4, ROW_WIDTH), "<f4")
    rows[:, 3] = 1.0
    rows[2, column] = value
    return prior_frames(data=rows.tobytes())


@pytest.mark.parametrize(
    ("request_", "reason", "field_"),
    [
        (clip(0), "CLIP_LENGTH_OUT_OF_RANGE", "frame_count"),
        (clip(2401), "CLIP_LENGTH_OUT_OF_RANGE", "frame_count"),
        (clip(40, 17), "TOO_MANY_SAMPLES", "sample_count"),
        (clip(priority=session_pb2.PRIORITY_CLASS_HERO), "NOT_FOR_CLIPS", "open.priority"),
        (clip(lookahead_frames=40), "NOT_FOR_CLIPS", "open.lookahead_frames"),
        (clip(resume_token="of a session"), "NOT_FOR_CLIPS", "open.resume_token"),
        (clip(60, constraints=[waypoint(59), waypoint(60)]), "CONSTRAINT_OUTSIDE_CLIP", "open.constraints[1].frame"),
        (clip(denoise_steps=11), "DENOISE_STEPS_OUT_OF_RANGE", "open.denoise_steps"),
        (clip(prompts=[motion_pb2.PromptSpan(prompt_id=1)]), "EMPTY_PROMPT", "open.prompts[0].text"),
        (clip(history_frames=6), "HISTORY_OUT_OF_RANGE", "open.history_frames"),
        (clip(history_frames=164), "HISTORY_OUT_OF_RANGE", "open.history_frames"),
        (clip(**prior_frames(frame_count=3)), "PRIOR_FRAMES_OUT_OF_RANGE", "open.prior_frames.frame_count"),
        (clip(**prior_frames(frame_count=8)), "WRONG_LENGTH", "open.prior_frames.data"),
        (clip(**prior_frames(), start_pose=session_pb2.StartPose()), "AMBIGUOUS_START", "open.start_pose"),
        (clip(**spoiled(3, 0.5)), "NOT_A_ROTATION", "open.prior_frames.data"),
        (clip(**spoiled(0, np.nan)), "NOT_FINITE", "open.prior_frames.data"),
        (clip(**spoiled(2, 2e4)), "COORDINATE_OUT_OF_RANGE", "open.prior_frames.data"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
async def test_invalid_request_is_refused_with_its_field_and_what_is_allowed(
    server: LocalServer, request_: service_pb2.GenerateClipRequest, reason: str, field_: str
) -> None:
    code, info, fault = await refusal(server, request_)
    assert code is grpc.StatusCode.INVALID_ARGUMENT
    assert (info.reason, fault) == (reason, field_)
    assert info.metadata["allowed"]
    assert server.runner.prepared == [], "no sample was begun"


async def test_full_server_refuses_a_clip_and_begins_no_sample() -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer(engine_config=EngineConfig(max_clips=2)) as server:
        code, info, _ = await refusal(server, clip(samples=3))
        assert (code, info.reason) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "CLIP_LIMIT")
        samples = await generate(server, clip(samples=2))
        assert len(samples[1].rows) == 60, "the places of the refused call are free"


def hold_up(server: LocalServer) -> Callable[[], None]:
    """Make denoising steps do nothing until the returned function is called: jobs never get done."""
    denoise = server.runner.denoise

    def stall(job_ids: object) -> list[object]:
        return []

    server.runner.denoise = stall  # type: ignore[assignment, method-assign]

    def release() -> None:
        server.runner.denoise = denoise  # type: ignore[method-assign]

    return release


async def no_job_is_left(server: LocalServer) -> None:
    await until_true(lambda: not server.runner.jobs and not server.engine.num_sessions)


async def test_deadline_ends_the_call_and_its_work(server: LocalServer) -> None:
    release = hold_up(server)
    code, _, _ = await refusal(server, clip(400, 4), timeout_s=0.3)
    assert code is grpc.StatusCode.DEADLINE_EXCEEDED
    await no_job_is_left(server)
    release()
    assert len((await generate(server, clip(40)))[0].rows) == 40


async def test_call_without_a_deadline_ends_after_the_server_s_limit() -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer(Limits(max_clip_s=0.2)) as server:
        release = hold_up(server)
        code, info, _ = await refusal(server, clip(40), timeout_s=None)
        assert (code, info.reason) == (grpc.StatusCode.DEADLINE_EXCEEDED, "CLIP_TOO_SLOW")
        await no_job_is_left(server)
        release()


async def test_cancelled_call_stops_its_work(server: LocalServer) -> None:
    release = hold_up(server)
    asking = asyncio.create_task(generate(server, clip(400)))
    await until_true(lambda: server.runner.prepared)
    asking.cancel()
    await no_job_is_left(server)
    release()


async def test_failed_sample_ends_its_call_with_a_reason(server: LocalServer) -> None:
    def poisoned(job: WindowJob) -> bool:
        return job.seed == 6

    server.runner.poisoned = poisoned
    code, info, _ = await refusal(server, clip(200, 3, seed=5))
    assert (code, info.reason) == (grpc.StatusCode.INTERNAL, "CLIP_LOST")
    await no_job_is_left(server)


async def test_server_that_shuts_down_ends_its_clips_and_refuses_more(server: LocalServer) -> None:
    release = hold_up(server)
    asking = asyncio.create_task(refusal(server, clip(400)))
    await until_true(lambda: server.runner.prepared)
    server.service.close_all()
    code, info, _ = await asking
    assert (code, info.reason) == (grpc.StatusCode.UNAVAILABLE, "CLIP_LOST")
    await server.service.finished()
    code, info, _ = await refusal(server, clip())
    assert (code, info.reason) == (grpc.StatusCode.UNAVAILABLE, "DRAINING")
    release()


class Gone:
    """The context of a call whose client went while something was written to it."""

    def time_remaining(self) -> None:
        return None

    async def write(self, response: service_pb2.GenerateClipResponse) -> None:
        raise grpc.aio.InternalError("Failed execute_batch")


async def test_client_that_leaves_during_a_write_is_not_logged_as_an_error(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer() as server:
        peer = Peer(PeerLimits(), 0.0)
        request = service_pb2.GenerateClipRequest(frame_count=8)
        await server.service.clips.generate(request, Gone(), peer)  # type: ignore[arg-type]
        await server.service.clips.finished()
    assert errors(caplog) == []
