"""Clips: what comes of each sample and in which order, what is refused, and what a client that goes away leaves."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_compliance.messages import waypoint
from motiongen_compliance.talk import LIMIT_S
from motiongen_compliance.target import Target

REFUSALS = (grpc.StatusCode.INVALID_ARGUMENT, grpc.StatusCode.NOT_FOUND, grpc.StatusCode.RESOURCE_EXHAUSTED)


def clip(num_frames: int, num_samples: int = 1, **opening: object) -> service_pb2.GenerateClipRequest:
    return service_pb2.GenerateClipRequest(
        open=session_pb2.OpenSession(**opening),  # type: ignore[arg-type]
        frame_count=num_frames,
        sample_count=num_samples,
    )


def told(target: Target) -> Iterator[service_pb2.GenerateClipRequest]:
    """Mistakes that every server must refuse, whatever its model."""
    model, limits = target.catalog.models[0], target.catalog.limits
    yield clip(0)
    yield clip(limits.max_clip_frames + 1)
    yield clip(40, limits.max_clip_samples + 1)
    yield clip(40, priority=session_pb2.PRIORITY_CLASS_HERO)
    yield clip(40, constraints=[waypoint(40)])
    yield clip(40, denoise_steps=model.max_denoise_steps + 1)
    yield clip(40, history_frames=model.max_history_frames + model.patch_frames)
    yield clip(40, prior_frames=motion_pb2.FrameChunk(frame_count=model.patch_frames, data=b"1234"))


async def test_every_sample_is_opened_sent_in_order_and_summed_up(target: Target) -> None:
    rig, patch = target.catalog.rigs[0], target.catalog.models[0].patch_frames
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
        elif part == "chunk":
            assert response.chunk.first_frame == frames[response.sample]
            assert len(response.chunk.data) == width * response.chunk.frame_count
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


async def test_a_mistake_ends_the_call_with_its_reason(target: Target) -> None:
    for request in told(target):
        with pytest.raises(grpc.aio.AioRpcError) as failure:
            _ = [response async for response in target.stub.GenerateClip(request, timeout=LIMIT_S)]
        assert failure.value.code() is grpc.StatusCode.INVALID_ARGUMENT, request
        status = rpc_status.from_call(failure.value)
        assert status is not None
        info = error_details_pb2.ErrorInfo()
        assert status.details[0].Unpack(info)
        assert info.reason
        assert info.domain == "motiongen"
        assert info.metadata["allowed"]


async def test_a_client_that_goes_away_leaves_a_server_that_serves(target: Target) -> None:
    limits = target.catalog.limits
    for _ in range(5):
        call = target.stub.GenerateClip(clip(limits.max_clip_frames, 2), timeout=LIMIT_S)
        async for _response in call:
            break
        call.cancel()
    async with asyncio.timeout(LIMIT_S):
        responses = [response async for response in target.stub.GenerateClip(clip(8), timeout=LIMIT_S)]
    assert responses[-1].WhichOneof("part") == "summary"
