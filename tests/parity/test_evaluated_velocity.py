"""The evaluation lays the same trajectory under a window for a velocity as the server does."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from motiongen_ardy.capabilities import LocomotionPreset
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.evaluate.gait import gait_of
from motiongen_ardy.evaluate.steering import add_lead, lead_by
from motiongen_ardy.evaluate.take import Steer
from motiongen_server.engine.locomotion import gait_of as server_gait_of
from motiongen_server.engine.session.velocity import Velocity, root_state
from motiongen_server.engine.types import (
    Direction,
    Gait,
    Guidance,
    PlanCause,
    Priority,
    RootTrajectory,
    SessionKey,
    SetVelocity,
    WindowJob,
)
from motiongen_server.runner.targets import job_targets

FPS, HORIZON = 20, 40
SKELETON = load_skeleton("core27")


@pytest.mark.parametrize("stride", [1, 5])
@pytest.mark.parametrize("seed", range(40))
def test_the_paths_are_equal(seed: int, stride: int) -> None:
    random = np.random.default_rng(seed)
    positions = (random.normal(size=(seed % 6 + 1, 3)) / 15).astype(np.float32).cumsum(axis=0)
    heading = float(random.uniform(-4, 4))
    asked = None if seed % 2 else float(random.uniform(-4, 4))
    x, z = (0.0, 0.0) if seed % 7 == 0 else (float(value) for value in random.normal(size=2) * 2)
    hold, first = int(random.integers(5, 90)), int(random.integers(0, 300))
    begin = first + int(random.integers(0, hold + 10))
    path = Velocity(x, z, asked, hold, first).path(begin, begin + HORIZON, root_state(positions, heading, FPS), FPS)
    lead = lead_by(Steer(first, x, z, asked, hold), begin, HORIZON, positions[:, [0, 2]], heading, FPS)
    assert (path is None) == (lead is None)
    if path is None or lead is None:
        return
    done = Targets(SKELETON)
    add_lead(done, lead, begin, stride)
    expected = job_targets(SKELETON, job_of(path), stride)
    assert expected is not None
    assert done.planned == expected.planned
    for name in ("ground", "heading"):
        mine, theirs = getattr(done, name), getattr(expected, name)
        assert mine.keys() == theirs.keys()
        assert all(torch.allclose(mine[frame], theirs[frame], atol=1e-4) for frame in theirs)


def job_of(path: RootTrajectory) -> WindowJob:
    """A job of which only the constraints count."""
    return WindowJob(
        job_id=1,
        session=SessionKey(1, 1),
        plan=1,
        first_frame=path.first_frame,
        history=np.zeros((0, 1), np.float32),
        start_pose=None,
        embedding=None,
        constraints=(path,),
        seed=0,
        num_steps=2,
        guidance=Guidance(1.0, 1.0),
        deadline=0.0,
        priority=Priority.NEAR,
        cause=PlanCause.CONTINUE,
        created_at=0.0,
    )


def test_what_the_client_asks_holds_over_a_velocity() -> None:
    targets = Targets(SKELETON)
    targets.add_waypoints([5], torch.tensor([[9.0, 9.0]]))
    lead = lead_by(Steer(0, 1.0, 0.0), 0, HORIZON, np.zeros((1, 2)), 0.0, FPS)
    assert lead is not None
    add_lead(targets, lead, 0, 1)
    assert targets.ground[5].tolist() == [9.0, 9.0]
    assert len(targets.ground) == HORIZON


GAITS = (
    ("stand", 0.0, "forward"),
    ("walk", 0.15, "forward"),
    ("run", 2.0, "forward"),
    ("back", 0.15, "backward"),
    ("left", 0.15, "left"),
    ("right", 0.15, "right"),
)


def test_the_gaits_are_equal() -> None:
    here = [LocomotionPreset(name, name, speed, direction) for name, speed, direction in GAITS]
    nothing = np.zeros(3, np.float32)
    there = [Gait(name, name, speed, Direction[direction.upper()], nothing) for name, speed, direction in GAITS]
    random = np.random.default_rng(0)
    chosen = set()
    held_here, held_there = None, None
    for _ in range(400):
        x, z = (float(value) for value in random.normal(size=2) * 1.5)
        heading = None if random.random() < 0.3 else float(random.uniform(-4, 4))
        held_here = gait_of(here, Steer(0, x, z, heading), held_here)
        held_there = server_gait_of(there, SetVelocity(SessionKey(1, 1), 1, 0.0, x, z, heading, 20), held_there)
        assert held_here is not None
        assert held_there is not None
        assert held_here.name == held_there.name
        chosen.add(held_here.name)
    assert chosen == {name for name, _, _ in GAITS}
    assert gait_of(here, Steer(0, 0.0, 1.0, keep_prompt=True)) is None
    assert gait_of((), Steer(0, 0.0, 1.0)) is None
