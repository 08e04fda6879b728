"""Clips that their clients do not read: the memory that the gateway holds for them, and how the calls end."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import grpc
import grpc.aio
import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from motiongen.v1 import service_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from tests.attack.calls import OPTIONS
from tests.attack.server import MIB, Attacked, attacked
from tests.waiting import LIMIT_S, try_again

BUDGET_MIB = 2
CALLS, SAMPLES = 10, 16
LOOKAHEAD_FRAMES = 160
"""What is generated of a sample while nothing is read: 73 KB. For all samples it is six times the budget."""
SLACK_MIB = 4
"""For what gRPC buffers of each call before it holds a writer back, and other growth: 1 to 2 MiB, but ten times that if
nothing were bounded."""
SMALL_WINDOWS = (*OPTIONS, ("grpc.http2.bdp_probe", 0), ("grpc.http2.lookahead_bytes", 1 << 16))
"""Without these, this client's gRPC buffers megabytes that the client does not read."""
SETTINGS = ("--devices", "cpu:3", "--max-waiting-mib", str(BUDGET_MIB), "--peer-clip-samples", str(CALLS * SAMPLES),
            "--admit-load", "1000", "--degrade", "false", "--profile-s", "0.3")  # fmt: skip
FRAMES, CLOSES = "motiongen_frames_sent_total", "motiongen_session_closes_total"


class Readings:
    """The server's metrics, and the gateway's memory. grown_mib: its largest growth since `begin`."""

    def __init__(self, server: Attacked) -> None:
        self._server = server
        self._least = 0
        self.grown_mib = 0.0

    def begin(self) -> None:
        self._least = self._server.process.memory_info().rss
        self.grown_mib = 0.0

    async def values(self) -> dict[str, float]:
        """Metrics by name, summed over their labels."""
        self.grown_mib = max(self.grown_mib, (self._server.process.memory_info().rss - self._least) / MIB)
        async with httpx.AsyncClient() as client:
            text = (await client.get(f"http://127.0.0.1:{self._server.ops_port}/metrics")).text
        sums: dict[str, float] = {}
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                sums[sample.name] = sums.get(sample.name, 0.0) + sample.value
        return sums


async def status_of(call: grpc.aio.UnaryStreamCall[Any, Any]) -> grpc.StatusCode:
    """The status with which a call ends, after reading all that is left of it."""
    try:
        while await call.read() is not grpc.aio.EOF:
            pass
    except grpc.aio.AioRpcError:
        pass
    return await call.code()


async def generated_or_ended(readings: Readings, before: dict[str, float], others: int) -> None:
    """Wait until all frames of `others` calls and one more are generated, or the others have ended.

    before: the metrics before the first call.
    """
    while True:
        values = await readings.values()
        made, closed = (values[name] - before.get(name, 0.0) for name in (FRAMES, CLOSES))
        if made >= (others + 1) * SAMPLES * LOOKAHEAD_FRAMES or closed >= others * SAMPLES > 0:
            return
        await try_again()


@pytest.mark.timeout(3 * LIMIT_S)
async def test_unread_clips_hold_no_more_than_the_budget_and_are_ended(tmp_path: Path) -> None:
    asked = service_pb2.GenerateClipRequest(frame_count=2 * LOOKAHEAD_FRAMES, sample_count=SAMPLES)
    with attacked(tmp_path / "log", SETTINGS) as server:
        readings = Readings(server)
        async with grpc.aio.insecure_channel(server.address, SMALL_WINDOWS) as channel:
            stub = MotionServiceStub(channel)
            for _ in range(4):  # memory that any first clip takes for good
                assert await status_of(stub.GenerateClip(asked)) is grpc.StatusCode.OK
            before = await readings.values()
            readings.begin()
            calls = []
            for others in range(CALLS):  # one by one, so that little is under way from the engines
                calls.append(stub.GenerateClip(asked))
                assert isinstance(await calls[-1].read(), service_pb2.GenerateClipResponse)
                await generated_or_ended(readings, before, others)
            values = await readings.values()
            print(f"{values['motiongen_outbound_queue_bytes']} bytes wait, grown by {readings.grown_mib:.1f} MiB")
            assert values["motiongen_outbound_queue_bytes"] <= BUDGET_MIB * MIB
            assert readings.grown_mib < BUDGET_MIB + SLACK_MIB
            statuses = await asyncio.gather(*(status_of(call) for call in calls))
        assert statuses.count(grpc.StatusCode.RESOURCE_EXHAUSTED) >= CALLS - 2
        assert set(statuses) <= {grpc.StatusCode.RESOURCE_EXHAUSTED, grpc.StatusCode.OK}
    assert server.exit_code == 0
