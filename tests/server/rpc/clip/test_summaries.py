"""The residuals in the summary of a clip."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import numpy as np
import pytest

from motiongen.v1 import motion_pb2
from tests.contract.local import LocalServer
from tests.server.engine.fakes import SPEED
from tests.server.rpc.clip.test_calls import clip, generate, waypoint
from tests.waiting import LIMIT_S


@pytest.fixture
async def server() -> AsyncIterator[LocalServer]:
    async with asyncio.timeout(LIMIT_S), LocalServer() as local:
        yield local


async def test_summary_has_the_residual_of_each_constraint(server: LocalServer) -> None:
    """The fake character walks along x."""
    path = motion_pb2.RootTrajectory(positions=[0.0, 0.0, 0.0, 0.5])
    constraints = [
        waypoint(40, x=40 * SPEED / 20 + 0.3, z=0.4, constraint_id=7),
        motion_pb2.Constraint(constraint_id=3, frame=0, root_trajectory=path),
    ]
    samples = await generate(server, clip(60, constraints=constraints))
    summary = samples[0].summary
    assert summary is not None
    point, followed = summary.residuals
    assert (point.constraint_id, point.frame_count) == (7, 1)
    assert point.position_m.worst == pytest.approx(0.5, abs=1e-5)
    assert not point.HasField("heading_rad")
    assert (followed.constraint_id, followed.frame_count) == (3, 2)
    assert followed.position_m.worst == pytest.approx(np.hypot(SPEED / 20, 0.5), abs=1e-5)
    assert followed.position_m.mean == pytest.approx(followed.position_m.worst / 2, abs=1e-5)


async def test_constraints_with_the_same_id_have_separate_residuals(server: LocalServer) -> None:
    """The first may be met until frame 100, and is reported long before the last, which is missed."""
    within = waypoint(10, x=20 * SPEED / 20, z=0.0, constraint_id=7)
    within.last_frame = 100
    soon = motion_pb2.Constraint(constraint_id=7, at_any_frame=True, waypoint=motion_pb2.Waypoint(x=5.0, z=5.0))
    missed = waypoint(60, x=60 * SPEED / 20, z=3.0, constraint_id=7)
    samples = await generate(server, clip(120, constraints=[within, soon, missed]))
    assert samples[0].summary is not None
    assert samples[0].opened is not None
    assert [each.constraint_id for each in samples[0].opened.placements] == [7, 7]
    met, far, aside = samples[0].summary.residuals
    assert {each.constraint_id for each in (met, far, aside)} == {7}
    assert met.position_m.worst == pytest.approx(0.0, abs=1e-5)
    assert far.position_m.worst > 4.0
    assert aside.position_m.worst == pytest.approx(3.0, abs=1e-5)
