"""Ends of calls for clips: what does not end one, and what the metrics count of a refused one."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import grpc
import pytest

from motiongen_server.engine.types import Code, EventRefused, Outcome, SessionKey
from motiongen_server.ops.metrics import Metrics
from motiongen_server.rpc.clip.call import Call
from motiongen_server.rpc.convert.frames import PLAIN
from tests.contract.local import LocalServer
from tests.server.rpc.clip.test_calls import clip, refusal
from tests.waiting import LIMIT_S


def test_late_answer_to_a_close_does_not_end_the_call() -> None:
    call = Call([], None, PLAIN)  # type: ignore[arg-type]
    late = Outcome(SessionKey(1, 0), 2, Code.NOT_FOUND, reason="SESSION_NOT_OPEN")
    assert call.responses(late) == []
    with pytest.raises(EventRefused):
        call.responses(replace(late, event_seq=1))


async def test_metrics_count_a_refused_number_of_samples_as_the_most_allowed() -> None:
    metrics = Metrics()
    async with asyncio.timeout(LIMIT_S), LocalServer() as server:
        server.service.clips._stream_metrics = metrics
        code, info, _ = await refusal(server, clip(samples=2**32 - 1))
    assert (code, info.reason) == (grpc.StatusCode.INVALID_ARGUMENT, "TOO_MANY_SAMPLES")
    assert metrics.registry.get_sample_value("motiongen_clips_total", {"code": "INVALID_ARGUMENT"}) == 16
