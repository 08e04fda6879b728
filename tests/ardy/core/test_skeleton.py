"""The four skeletons: their trees, sizes and neutral poses, and a model of each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, save_checkpoint
from motiongen_ardy.checkpoint.config import SKELETON_CLASSES
from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH
from motiongen_ardy.core.rotation import axis_angle_to_matrix
from motiongen_ardy.core.skeleton import (
    Skeleton,
    UnknownJoint,
    UnknownSkeleton,
    forward_kinematics,
    hip_lines,
    load_skeleton,
    positions_from_global,
    skeleton_names,
)
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.config import DenoiserConfig, ModelConfig, TokenizerConfig, TransformerConfig
from motiongen_ardy.model.model import Model, build_model
from motiongen_ardy.model.rollout import RolloutRequest, rollout

SIZES = {"core27": (27, 330), "g134": (34, 414), "soma30": (30, 366), "soma77": (77, 930)}


@pytest.fixture(params=sorted(SIZES))
def skeleton(request: pytest.FixtureRequest) -> Skeleton:
    return load_skeleton(request.param)


def make_model(skeleton: Skeleton) -> Model:
    torch.manual_seed(0)
    transformer = TransformerConfig(width=16, feed_forward=24, num_layers=1, num_heads=2)
    config = ModelConfig(
        skeleton=skeleton.name,
        fps=20,
        horizon=8,
        denoiser=DenoiserConfig(transformer, latent_dim=4, text_tokens=1, text_dim=3),
        tokenizer=TokenizerConfig(transformer, latent_dim=4, levels=(8,) * 4),
    )
    width = skeleton.feature_dim + LOCAL_ROOT_WIDTH
    return build_model(config, Stats(torch.zeros(width), torch.ones(width))).eval()


def ancestors(skeleton: Skeleton, joint: int) -> set[int]:
    parent = skeleton.parents[joint]
    return set() if parent < 0 else {parent} | ancestors(skeleton, parent)


def test_the_skeletons_are_the_four_tested_here() -> None:
    assert set(skeleton_names()) == set(SIZES)


def test_numbers_of_joints_and_features(skeleton: Skeleton) -> None:
    assert (skeleton.num_joints, skeleton.feature_dim) == SIZES[skeleton.name]
    assert len(set(skeleton.joint_names)) == skeleton.num_joints == len(skeleton.parents)
    assert skeleton.neutral_joints.shape == (skeleton.num_joints, 3)


def test_parents_precede_their_children(skeleton: Skeleton) -> None:
    assert skeleton.parents[0] == -1
    assert all(0 <= parent < joint for joint, parent in enumerate(skeleton.parents) if joint)


def test_joints_of_a_limb_chain_descend_from_its_first(skeleton: Skeleton) -> None:
    for chain in (skeleton.left_foot, skeleton.right_foot, skeleton.left_hand, skeleton.right_hand):
        assert len(chain) >= 2
        for joint in chain[1:]:  # a hand may branch into fingers
            assert chain[0] in ancestors(skeleton, joint)


def test_left_is_at_positive_x_and_feet_are_below(skeleton: Skeleton) -> None:
    right_hip, left_hip = skeleton.hip_joints
    neutral = skeleton.neutral_joints
    assert neutral[left_hip, 0] > 0 > neutral[right_hip, 0]
    assert neutral[skeleton.left_foot[0], 0] > 0 > neutral[skeleton.right_foot[0], 0]
    assert (neutral[list(skeleton.contact_joints), 1] < -0.5).all()
    assert np.ptp(neutral[:, 1]) < 2.5


def test_identity_rotations_give_the_neutral_pose(skeleton: Skeleton) -> None:
    root = torch.tensor([1.0, 0.9, -2.0], dtype=torch.float64)
    rest = torch.eye(3, dtype=torch.float64).expand(skeleton.num_joints, 3, 3)
    _, positions = forward_kinematics(skeleton, rest, root)
    assert torch.allclose(positions, torch.tensor(skeleton.neutral_joints) + root)


def test_the_hip_line_joins_the_positions_of_the_hips(skeleton: Skeleton) -> None:
    generator = torch.Generator().manual_seed(3)
    turns = axis_angle_to_matrix(3.0 * torch.rand(2, 5, skeleton.num_joints, 3, generator=generator))
    places = positions_from_global(skeleton, turns, torch.rand(2, 5, 3, generator=generator))
    right, left = skeleton.hip_joints
    torch.testing.assert_close(hip_lines(skeleton, turns), places[..., right, :] - places[..., left, :])


def test_motion_is_recovered_from_its_features(skeleton: Skeleton) -> None:
    layout = make_model(skeleton).representation
    rotations = torch.linalg.qr(torch.randn(6, skeleton.num_joints, 3, 3, generator=torch.Generator().manual_seed(1)))[
        0
    ]
    rotations = rotations * torch.linalg.det(rotations)[..., None, None]
    root = torch.linspace(0, 1, 18).reshape(6, 3)
    motion = Motion(rotations, root, torch.zeros(6, 4, dtype=torch.bool), 20)
    features = layout.features(motion.local_rotations[None], motion.root_positions[None], torch.tensor([6]))
    again = layout.motion(features)
    assert torch.allclose(again.local_rotations[0], rotations, atol=1e-5)
    assert torch.allclose(again.root_positions[0], root, atol=1e-6)


@pytest.mark.parametrize("name", sorted(set(SKELETON_CLASSES.values())))
def test_a_model_of_each_skeleton_is_saved_loaded_and_generates(name: str, tmp_path: Path) -> None:
    model = make_model(load_skeleton(name))
    save_checkpoint(model, tmp_path)
    loaded = load_checkpoint(tmp_path)
    features = rollout(loaded, RolloutRequest(20, torch.zeros(3), num_steps=2))
    assert features.shape == (20, SIZES[name][1])
    assert bool(features.isfinite().all())
    assert (loaded.config, loaded.skeleton) == (model.config, model.skeleton)


def test_unknown_names_list_the_known_ones(skeleton: Skeleton) -> None:
    with pytest.raises(UnknownSkeleton, match="core27, g134, soma30, soma77"):
        load_skeleton("core28")
    with pytest.raises(UnknownJoint, match=f"skeleton {skeleton.name} has no joint 'tail'; its joints are .*"):
        skeleton.index("tail")
