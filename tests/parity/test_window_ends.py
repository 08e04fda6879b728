"""Windows that end early because a target follows: a session matches the rollout, and goals of joints are met."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.rotation import rotation_y
from motiongen_ardy.model.model import Model
from motiongen_server.engine.types import Constraint, HeadingTarget, JointRotations, JointTargets, Waypoint
from tests.parity.conftest import TINY
from tests.parity.test_streamed_equals_rollout import compare, expected, stream

HEAD, HAND = 6, 16


@pytest.fixture(scope="module")
def obeying() -> Model:
    """The tiny model with planned roots and corrections."""
    model = load_checkpoint(TINY)
    model.sampling = replace(
        model.sampling, project_root=True, plan_root=True, reach_joints=True, join_tokens=True, face_root=True
    )
    return model


@pytest.mark.parametrize("goal", [39, 40, 41, 79, 80])
def test_targets_around_window_ends_match_the_rollout_and_turn_the_head(obeying: Model, goal: int) -> None:
    # This model has learned nothing: with seed 4 and a target at frame 80, rounding errors grow a thousandfold from
    # window to window.
    embedding = np.random.default_rng(1).standard_normal(32).astype(np.float32)
    targets, head = Targets(obeying.skeleton), rotation_y(torch.tensor(0.4))
    targets.add_waypoints([goal], torch.tensor([[1.3, -1.4]]))
    targets.add_heading([goal], torch.tensor([1.0]))
    targets.add_rotations(goal, [HEAD], head[None])
    constraints: tuple[Constraint, ...] = (
        Waypoint(1, goal, 1.3, -1.4),
        HeadingTarget(2, goal, 1.0),
        JointRotations(3, goal, (HEAD,), head[None].numpy()),
    )
    features = expected(obeying, embedding, targets, False)
    compare(obeying, stream(obeying, embedding, constraints, False), features)
    turned = obeying.representation.global_rotations(features)[goal, HEAD]
    assert torch.allclose(turned, head, atol=5e-3)


def test_closely_spaced_joint_targets_match_the_rollout_and_are_reached(obeying: Model) -> None:
    embedding = np.random.default_rng(5).standard_normal(32).astype(np.float32)
    places, goals = np.array([[1.0, 0.9, -1.9], [1.3, 1.2, -1.6]], np.float32), (34, 42, 50)
    targets, constraints = Targets(obeying.skeleton), []
    for number, goal in enumerate(goals, 1):
        targets.add_joints(goal, [0, HAND], torch.from_numpy(places))
        constraints.append(JointTargets(number, goal, (0, HAND), places))
    features = expected(obeying, embedding, targets, False)
    compare(obeying, stream(obeying, embedding, tuple(constraints), False), features)
    reached = obeying.representation.motion(features).positions(obeying.skeleton)[list(goals)][:, [0, HAND]]
    away = (reached - torch.from_numpy(places)).norm(dim=-1)
    # 20 to 70 cm away before it is corrected, which limits how fast it may move
    assert (away[:, 1] < 0.1).all()
    assert torch.cat([away[:, 0], away[1:, 1]]).max() < 1e-3
