"""Requests for clips with arbitrary content are served or refused."""

from __future__ import annotations

import grpc
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motiongen.v1 import service_pb2, session_pb2
from motiongen_compliance.target import Target
from tests.waiting import LIMIT_S

REFUSALS = (grpc.StatusCode.INVALID_ARGUMENT, grpc.StatusCode.NOT_FOUND, grpc.StatusCode.RESOURCE_EXHAUSTED)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=200), num_frames=st.integers(0, 60))
async def test_clip_with_arbitrary_content_is_generated_or_refused(
    local: Target, content: bytes, num_frames: int
) -> None:
    try:
        opening = session_pb2.OpenSession.FromString(content)
    except Exception:
        opening = session_pb2.OpenSession(request_id=content.hex())
    request = service_pb2.GenerateClipRequest(open=opening, frame_count=num_frames)
    code, parts = grpc.StatusCode.OK, []
    try:
        parts = [response async for response in local.stub.GenerateClip(request, timeout=LIMIT_S)]
    except grpc.aio.AioRpcError as failure:
        code = failure.code()
    assert code in REFUSALS or parts[-1].WhichOneof("part") == "summary"
