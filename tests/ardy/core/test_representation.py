"""Features, root operations and statistics: the golden vectors, and properties that hold for any features."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.core.representation import Representation, heading_angle
from motiongen_ardy.core.rotation import matrix_from_6d
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.train.feature_bank import natural_layout
from tests.ardy.conftest import GoldenModel

CORE = natural_layout(load_skeleton("core27"), 20)


def random_features(seed: int, layout: Representation = CORE, num_frames: int = 8) -> torch.Tensor:
    """Features (1, T, D) in natural units of random poses."""
    generator = torch.Generator().manual_seed(seed)
    joints = layout.skeleton.num_joints
    local = matrix_from_6d(torch.randn(1, num_frames, joints, 6, generator=generator))
    return layout.features(local, torch.randn(1, num_frames, 3, generator=generator))


def test_features_and_their_canonical_form_match_the_golden_vectors(golden: GoldenModel) -> None:
    layout, vectors = golden.model.representation, golden.vectors("features")
    features = layout.features(vectors["in.local_rot_mats"], vectors["in.root_positions"], vectors["in.lengths"])
    vectors.check("out.features", features)
    vectors.check("out.features_normalized", layout.normalize(features))
    vectors.check("out.features_canonical", torch.cat([layout.canonicalize(row[None]) for row in features]))


def test_motion_from_noisy_features_matches_the_golden_vectors(golden: GoldenModel) -> None:
    layout, vectors = golden.model.representation, golden.vectors("features")
    given_features = vectors["inverse.in.features"]
    motion = layout.motion(given_features)
    vectors.check("inverse.out.local_rot_mats", motion.local_rotations)
    vectors.check("inverse.out.posed_joints", motion.positions(layout.skeleton))
    vectors.check("inverse.out.posed_joints_from_positions", layout.positions(given_features, "positions"))
    vectors.check_equal("inverse.out.foot_contacts", motion.foot_contacts)


def test_root_operations_match_the_golden_vectors(golden: GoldenModel) -> None:
    layout, vectors = golden.model.representation, golden.vectors("root")
    root = vectors["in.root_normalized"]
    vectors.check("out.local_root_normalized", layout.local_root(root, vectors["in.lengths"]))
    moved, centre = layout.recentre(root, vectors["in.center_frame"])
    vectors.check("out.recentred", moved)
    vectors.check("out.center_pos", centre)
    vectors.check("out.translated", layout.translate_root(root, vectors["in.translation"]))
    vectors.check("out.heading_angle", layout.heading_of_root(root))
    vectors.check("out.rotated", layout.rotate(vectors["in.features"], vectors["in.angle"]))
    vectors.check("out.translated_2d", layout.translate_ground(vectors["in.features"], vectors["in.translation_2d"]))


def test_normalization_matches_the_golden_vectors(golden: GoldenModel) -> None:
    layout, vectors = golden.model.representation, golden.vectors("normalization")
    vectors.check("out.normalized", layout.normalize(vectors["in.features"]))
    vectors.check("out.unnormalized", layout.denormalize(vectors["in.features"]))
    vectors.check("out.global_root_normalized", layout.root_stats.normalize(vectors["in.global_root"]))
    vectors.check("out.local_root_normalized", layout.local_root_stats.normalize(vectors["in.local_root"]))
    tokenizer = golden.model.tokenizer
    assert tokenizer is not None
    vectors.check("out.latent_normalized", tokenizer.post_stats.normalize(vectors["in.latent"]))
    vectors.check("out.latent_unnormalized", tokenizer.post_stats.denormalize(vectors["in.latent"]))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), angle=st.floats(-3.1, 3.1))
def test_turning_clean_features_needs_no_orthonormalising(seed: int, angle: float) -> None:
    features, turn = random_features(seed), torch.tensor([angle])
    torch.testing.assert_close(
        CORE.rotate(features, turn, orthonormal=True), CORE.rotate(features, turn), atol=1e-5, rtol=0
    )


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), angle=st.floats(-1.5, 1.5))
def test_turning_features_turns_the_heading(seed: int, angle: float) -> None:
    features = random_features(seed)
    before = heading_angle(CORE.skeleton, CORE.positions(features))
    after = heading_angle(CORE.skeleton, CORE.positions(CORE.rotate(features, torch.tensor([angle]))))
    difference = torch.remainder(after - before - angle + torch.pi, 2 * torch.pi) - torch.pi
    assert difference.abs().max() < 1e-3


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), frame=st.integers(0, 7))
def test_recentring_puts_the_frame_at_the_origin_and_can_be_undone(seed: int, frame: int) -> None:
    root = CORE.root_stats.normalize(random_features(seed)[..., :5])
    moved, centre = CORE.recentre(root, frame)
    assert moved[0, frame, [0, 2]].abs().max() < 1e-6
    torch.testing.assert_close(CORE.translate_root(moved, centre), root, atol=1e-5, rtol=0)
