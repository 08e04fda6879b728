"""The Python client and a real server process: sessions open, play, change and close."""

from __future__ import annotations

import asyncio

import httpx
import numpy as np
import pytest

from motiongen_client import EventRefused, MotionClient, SessionOptions
from tests.conftest import LiveServer
from tests.waiting import LIMIT_S


async def test_two_sessions_play_and_one_changes_its_prompt(live_server: LiveServer) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(live_server.address) as client:
        walker = await client.open("a person walks", options=SessionOptions(seed=3))
        waver = await client.open("a person waves")
        frames = [frame async for frame in walker.frames(seconds=1)]
        outcome = await walker.set_prompt("a person runs")
        assert outcome.effective_frame is not None
        assert outcome.effective_frame > frames[-1].index, "frames that were shown are not replaced"
        frames += [frame async for frame in walker.frames(seconds=2)]
        assert [frame.index for frame in frames] == list(range(60))
        assert all(np.isfinite(frame.joint_positions_m()).all() for frame in frames)
        others = [frame async for frame in waver.frames(seconds=2, realtime=False)]
        assert [frame.index for frame in others] == list(range(40))
        end = await walker.close()
        assert end.reason == "client"


async def test_refused_edit_raises_its_error_and_the_session_plays_on(live_server: LiveServer) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(live_server.address) as client:
        session = await client.open("a person walks")
        with pytest.raises(EventRefused) as refused:
            await session.remove_constraints([99])
        assert refused.value.reason == "UNKNOWN_CONSTRAINT"
        assert len([frame async for frame in session.frames(seconds=1, realtime=False)]) == 20


async def test_running_server_is_alive_ready_and_has_metrics(live_server: LiveServer) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(live_server.address) as client:
        session = await client.open("a person walks")
        _ = [frame async for frame in session.frames(seconds=1, realtime=False)]
        async with httpx.AsyncClient(base_url=live_server.ops_url) as ops:
            answers = [(await ops.get(path)).status_code for path in ("/livez", "/healthz", "/readyz")]
            model = f'model="{client.catalog.models[0].model_id}"'
            lines: dict[str, str] = {}
            while (
                float(lines.get(f'motiongen_frames_sent_total{{engine="0",{model}}}', 0)) < 20
            ):  # reported from time to time
                metrics = (await ops.get("/metrics")).text
                lines = dict(line.rsplit(" ", 1) for line in metrics.splitlines() if not line.startswith("#"))
    assert answers == [200, 200, 200]
    assert float(lines[f'motiongen_session_opens_total{{code="OK",engine="0",{model}}}']) >= 1
    assert f"motiongen_build_info{{{model}" in metrics
