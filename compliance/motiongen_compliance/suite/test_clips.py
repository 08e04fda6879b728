"""Clips: the parts of each sample and their order, what is refused, and what happens when a client goes away."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import grpc
import numpy as np
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_compliance.messages import waypoint
from motiongen_compliance.talk import LIMIT_S, rig_of
from motiongen_compliance.target import Target


def clip(num_frames: int, num_samples: int = 1, **opening: object) -> service_pb2.GenerateClipRequest:
    return service_pb2.GenerateClipRequest(
        open=session_pb2.OpenSession(**opening),  # type: ignore[arg-type]
        frame_count=num_frames,
        sample_count=num_samples,
    )


def mistakes(target: Target) -> Iterator[tuple[service_pb2.GenerateClipRequest, str, str]]:
    """Mistakes that every server must refuse, whatever its model, with the reason and field of each."""
    model, limits = target.catalog.models[0], target.catalog.limits
    yield clip(0), "CLIP_LENGTH_OUT_OF_RANGE", "frame_count"
    yield clip(limits.max_clip_frames + 1), "CLIP_LENGTH_OUT_OF_RANGE", "frame_count"
    yield clip(40, limits.max_clip_samples + 1), "TOO_MANY_SAMPLES", "sample_count"
    yield clip(40, priority=session_pb2.PRIORITY_CLASS_HERO), "NOT_FOR_CLIPS", "open.priority"
    yield clip(40, lookahead_frames=limits.default_lookahead_frames), "NOT_FOR_CLIPS", "open.lookahead_frames"
    yield clip(40, resume_token="of a session"), "NOT_FOR_CLIPS", "open.resume_token"
    yield clip(40, resume_point=session_pb2.ResumePoint(attempt=1)), "RESUME_TOKEN_MISSING", "open.resume_point"
    yield clip(40, constraints=[waypoint(40)]), "CONSTRAINT_OUTSIDE_CLIP", "open.constraints[0].frame"
    yield clip(40, denoise_steps=model.max_denoise_steps + 1), "DENOISE_STEPS_OUT_OF_RANGE", "open.denoise_steps"
    longer = model.max_history_frames + model.patch_frames
    yield clip(40, history_frames=longer), "HISTORY_OUT_OF_RANGE", "open.history_frames"
    short = motion_pb2.FrameChunk(frame_count=model.patch_frames, data=b"1234")
    yield clip(40, prior_frames=short), "WRONG_LENGTH", "open.prior_frames.data"


async def test_every_sample_is_opened_sent_in_order_and_summed_up(target: Target) -> None:
    rig, patch = rig_of(target.catalog), target.catalog.models[0].patch_frames
    num_frames = 2 * target.catalog.models[0].horizon_frames + patch // 2
    width = 4 * sum(block.width for block in rig.blocks)
    request = clip(num_frames, 3, seed=9, constraints=[waypoint(num_frames - 1, 5, x=0.0, z=1.0)])
    parts: dict[int, list[str]] = {}
    frames = dict.fromkeys(range(3), 0)
    async for response in target.stub.GenerateClip(request, timeout=LIMIT_S):
        part = response.WhichOneof("part") or ""
        parts.setdefault(response.sample, []).append(part)
        if part == "opened":
            assert response.opened.seed == 9 + response.sample
            assert response.opened.frame_rate == rig.frame_rate
            assert (response.opened.lookahead_frames, response.opened.committed_horizon_frames) == (0, 0)
        elif part == "chunk":
            assert response.chunk.first_frame == frames[response.sample]
            assert len(response.chunk.data) == width * response.chunk.frame_count
            assert np.isfinite(np.frombuffer(response.chunk.data, "<f4")).all()
            frames[response.sample] += response.chunk.frame_count
        else:
            (residual,) = response.summary.residuals
            assert (residual.constraint_id, residual.frame_count) == (5, 1)
            assert residual.HasField("position_m")
            assert not residual.HasField("heading_rad")
    assert frames == dict.fromkeys(range(3), num_frames)
    for sequence in parts.values():
        assert (sequence[0], sequence[-1]) == ("opened", "summary")
        assert set(sequence[1:-1]) == {"chunk"}


async def test_mistake_ends_the_call_with_its_reason(target: Target) -> None:
    for request, reason, field in mistakes(target):
        with pytest.raises(grpc.aio.AioRpcError) as failure:
            _ = [response async for response in target.stub.GenerateClip(request, timeout=LIMIT_S)]
        assert failure.value.code() is grpc.StatusCode.INVALID_ARGUMENT, request
        status = rpc_status.from_call(failure.value)
        assert status is not None
        info = error_details_pb2.ErrorInfo()
        assert status.details[0].Unpack(info)
        assert (info.reason, info.domain) == (reason, "motiongen")
        assert info.metadata["allowed"]
        wrong = error_details_pb2.BadRequest()
        assert any(detail.Unpack(wrong) for detail in status.details)
        assert [violation.field for violation in wrong.field_violations] == [field]


async def test_server_goes_on_after_clients_cancel_their_clips(target: Target) -> None:
    limits = target.catalog.limits
    for _ in range(5):
        call = target.stub.GenerateClip(clip(limits.max_clip_frames, 2), timeout=LIMIT_S)
        async for _response in call:
            break
        call.cancel()
    async with asyncio.timeout(LIMIT_S):
        responses = [response async for response in target.stub.GenerateClip(clip(8), timeout=LIMIT_S)]
    assert responses[-1].WhichOneof("part") == "summary"
