"""A layout without statistics, and standing poses, for tests of the corrections of a window."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import matrix_from_6d, matrix_to_6d
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.core.stats import Stats

STANDING_HEIGHT_M = 0.966  # with this, the feet of the neutral pose are on the ground
Stand = Callable[[Tensor], Tensor]


@pytest.fixture(scope="session")
def layout() -> Representation:
    skeleton = load_skeleton("core27")
    width = skeleton.feature_dim + 4
    return Representation(skeleton, 20, Stats(torch.zeros(width), torch.ones(width)))


@pytest.fixture(scope="session")
def stand(layout: Representation) -> Stand:
    """Normalised features (1, T, D) of a standing person, knees bent and arms hanging, while the root moves by (T, 3)
    metres; all feet are labelled as in contact.
    """

    def make(moves: Tensor) -> Tensor:
        skeleton = layout.skeleton
        bent = torch.eye(3).repeat(len(moves), skeleton.num_joints, 1, 1)
        for side in ("Left", "Right"):
            for joint, angle in (("UpLeg", -0.3), ("Leg", 0.6), ("Foot", -0.3)):
                cosine, sine = torch.cos(torch.tensor(angle)), torch.sin(torch.tensor(angle))
                turn = torch.tensor([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
                bent[:, skeleton.index(side + joint)] = turn
        arm = torch.tensor([[0.36, 0.93, 0.0], [-0.93, 0.36, 0.0], [0.0, 0.0, 1.0]])
        fold = torch.tensor([[0.9, 0.0, 0.436], [0.0, 1.0, 0.0], [-0.436, 0.0, 0.9]])
        for side, down, inward in (("Left", arm, fold.T), ("Right", arm.T, fold)):
            bent[:, skeleton.index(side + "Arm")] = matrix_from_6d(matrix_to_6d(down))
            bent[:, skeleton.index(side + "ForeArm")] = matrix_from_6d(matrix_to_6d(inward))
        root = moves + torch.tensor([0.0, STANDING_HEIGHT_M, 0.0])
        features = layout.features(bent[None], root[None])
        lowest = layout.positions(features)[0, 0, skeleton.left_foot[1], 1] - moves[0, 1] - 0.012
        features = layout.features(bent[None], root[None] - torch.tensor([0.0, float(lowest), 0.0]))
        features[..., layout.contact_block] = 1.0
        return layout.normalize(features)

    return make
