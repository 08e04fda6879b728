"""The evaluation lays the same trajectory under a window for a velocity as the server does."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from ardy.capabilities import LocomotionPreset
from ardy.constraint import Targets
from ardy.evaluate.gait import gait_of
from ardy.evaluate.steering import add_steering
from ardy.evaluate.take import Steer
from ardy.skeleton import load_skeleton
from server.engine.locomotion import gait_of as server_gait_of
from server.engine.types import Direction, Gait, SessionKey, SetVelocity
from server.engine.velocity import Velocity, root_state

FPS, HORIZON = 20, 40


@pytest.mark.parametrize("seed", range(20))
def test_the_paths_are_equal(seed: int) -> None:
    random = np.random.default_rng(seed)
    positions = random.normal(size=(2 if seed % 3 else 1, 3)).astype(np.float32).cumsum(axis=0)
    heading = float(random.uniform(-4, 4))
    asked = None if seed % 2 else float(random.uniform(-4, 4))
    x, z = (float(value) for value in random.normal(size=2) * 2)
    hold, first = int(random.integers(5, 90)), int(random.integers(0, 300))
    path = Velocity(x, z, asked, hold, first).path(first, first + HORIZON, root_state(positions, heading, FPS), FPS)
    assert path is not None
    targets = Targets(load_skeleton("core27"))
    root = torch.from_numpy(positions[:, [0, 2]])
    add_steering(targets, Steer(first, x, z, asked, hold), first, HORIZON, root, heading, FPS)
    frames = sorted(targets.ground)
    assert frames == list(range(path.first_frame, path.last_frame + 1))
    ground = torch.stack([targets.ground[frame] for frame in frames]).numpy()
    assert np.allclose(ground, path.xz, atol=1e-4)
    if path.heading is None:
        assert targets.heading == {}
    else:
        told = torch.stack([targets.heading[frame] for frame in frames]).numpy()
        assert np.allclose(told, np.stack([np.cos(path.heading), np.sin(path.heading)], axis=1), atol=1e-5)


def test_what_the_client_asks_holds_over_a_velocity() -> None:
    targets = Targets(load_skeleton("core27"))
    targets.add_root([5], torch.tensor([[9.0, 9.0]]))
    add_steering(targets, Steer(0, 1.0, 0.0), 0, HORIZON, torch.zeros(1, 2), 0.0, FPS)
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
