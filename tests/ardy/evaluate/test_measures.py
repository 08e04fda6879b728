"""Measures on motions whose figures are known: a pushed statue, feet that stay, a toe that lifts."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.evaluate.measures import feet
from motiongen_ardy.evaluate.measures.matching import frechet_distance, ranks
from motiongen_ardy.evaluate.measures.posture import frozen_share, lean
from motiongen_ardy.evaluate.measures.root import ground_speed, is_moving, travel_angle, turn_rate, turned
from motiongen_ardy.evaluate.measures.smooth import accelerations, seam_jumps

FPS = 20
SKELETON = load_skeleton("core27")


def statue(num_frames: int, speed: float = 1.0) -> Tensor:
    """(T, J, 3): the neutral pose on the ground, pushed along +Z."""
    pose = torch.tensor(SKELETON.neutral_joints).float()
    pose = pose - torch.tensor([0.0, float(pose[:, 1].min()), 0.0])
    along = torch.arange(num_frames)[:, None, None] * speed / FPS
    return pose + along * torch.tensor([0.0, 0.0, 1.0])


def stepping(num_frames: int) -> Tensor:
    """As `statue`, but the left foot's joints stay where they are."""
    positions = statue(num_frames)
    left = list(SKELETON.left_foot)
    positions[:, left] = positions[:1, left]
    return positions


def test_a_pushed_statue_glides_all_the_time() -> None:
    positions = statue(60)
    assert feet.slowest_foot(SKELETON, positions, FPS) == pytest.approx(1.0, abs=1e-3)
    assert feet.glide_share(SKELETON, positions, FPS) == 1.0
    assert feet.skating_ratio(SKELETON, positions) == 1.0


def test_a_body_with_a_planted_foot_does_not_glide() -> None:
    positions = stepping(60)
    assert feet.slowest_foot(SKELETON, positions, FPS) == pytest.approx(0.0, abs=1e-4)
    assert feet.glide_share(SKELETON, positions, FPS) == 0.0


def test_a_standing_body_has_no_slowest_foot_ratio() -> None:
    assert math.isnan(feet.slowest_foot(SKELETON, statue(60, 0.0), FPS))


def test_skating_counts_only_joints_labelled_as_in_contact() -> None:
    positions = stepping(40)
    labels = torch.zeros(40, 4, dtype=torch.bool)
    labels[:, :2] = True
    assert feet.skate_in_contact(SKELETON, positions, labels, FPS) == pytest.approx(0.0, abs=1e-4)
    labels[:, 2] = True
    assert feet.skate_in_contact(SKELETON, positions, labels, FPS) == pytest.approx(1 / 3, abs=1e-3)
    assert math.isnan(feet.skate_in_contact(SKELETON, positions, torch.zeros_like(labels), FPS))


def test_a_sunk_body_penetrates_the_ground_and_a_raised_one_does_not() -> None:
    raised, sunk = statue(5) + torch.tensor([0.0, 0.1, 0.0]), statue(5) - torch.tensor([0.0, 0.1, 0.0])
    assert feet.penetration(SKELETON, raised) == 0.0
    assert feet.penetration(SKELETON, sunk) > 0.05
    assert feet.foot_height(SKELETON, raised) - feet.foot_height(SKELETON, sunk) == pytest.approx(0.2, abs=1e-5)


def test_first_lift_reports_its_time_and_the_distance_before_it() -> None:
    positions = statue(60, 0.0)
    positions[20:, :, 2] += torch.arange(1, 41)[:, None] / FPS  # 1 m/s from frame 20 on
    positions[30:, SKELETON.left_foot[1], 1] += 0.05
    lift = feet.first_lift(SKELETON, positions, 20, FPS)
    assert lift.seconds == pytest.approx(0.5)
    assert lift.root_m == pytest.approx(0.5, abs=0.06)
    assert lift.glided_m == pytest.approx(0.5, abs=0.06)


def test_leaning_over_planted_feet_is_not_gliding() -> None:
    positions = statue(60, 0.0)
    positions[20:40, 0, 2] += torch.arange(1, 21) / FPS / 10
    lift = feet.first_lift(SKELETON, positions[:40], 20, FPS)
    assert lift.root_m == pytest.approx(0.095, abs=0.01)
    assert lift.glided_m == pytest.approx(0.0, abs=1e-5)


def test_without_a_lift_the_whole_distance_is_glided() -> None:
    positions = statue(60, 0.0)
    positions[20:, :, 2] += torch.arange(1, 41)[:, None] / FPS
    lift = feet.first_lift(SKELETON, positions, 20, FPS)
    assert lift.seconds == pytest.approx(1.95)
    assert lift.glided_m == pytest.approx(1.95, abs=0.06)


def test_toes_swivel_only_while_they_are_on_the_ground() -> None:
    dragged = statue(21)  # 1 m over the ground
    assert feet.swivelled(SKELETON, dragged) == pytest.approx(1.0, abs=1e-3)
    stepped = dragged.clone()
    stepped[3:18, :, 1] += 0.05
    assert feet.swivelled(SKELETON, stepped) == pytest.approx(0.2, abs=0.06)


def test_a_stop_is_measured_in_seconds_and_steps() -> None:
    positions = statue(80)
    positions[40:] = positions[40]  # stops at 2 s
    positions[24:28, SKELETON.left_foot[1], 1] += 0.06
    positions[32:36, SKELETON.right_foot[1], 1] += 0.06
    seconds, steps = feet.stop(SKELETON, positions, 20, FPS)
    assert seconds == pytest.approx(1.0, abs=0.25)
    assert steps == 2


def test_ground_speed_travel_angle_and_turn_rate() -> None:
    positions = statue(40, 2.0)
    root = positions[:, 0, [0, 2]]
    assert ground_speed(root, FPS).mean() == pytest.approx(2.0, abs=1e-3)
    assert is_moving(root, FPS)
    assert not is_moving(root[:1].expand(9, 2), FPS)
    assert travel_angle(root) == pytest.approx(0.0, abs=1e-6)
    assert float(turned(math.radians(170), math.radians(-170))) == pytest.approx(math.radians(-20), abs=1e-5)
    spin = torch.arange(60) * 0.3 + 3.0  # through the wrap, 6 radians a second
    assert turn_rate(torch.remainder(spin, math.tau), FPS).mean() == pytest.approx(6.0, abs=1e-3)


def test_acceleration_of_a_free_fall() -> None:
    time = torch.arange(20) / FPS
    positions = torch.zeros(20, 1, 3)
    positions[:, 0, 1] = -0.5 * 9.81 * time**2
    assert accelerations(positions, FPS) == pytest.approx(torch.full((18, 1), 9.81), abs=1e-2)


def test_seam_jumps_are_measured_only_at_the_given_frames() -> None:
    positions = statue(60)
    positions[30:] += torch.tensor([0.2, 0.0, 0.0])
    quiet, jump = seam_jumps(positions, [15, 30], FPS)
    assert quiet[0] == pytest.approx(1 / FPS, abs=1e-3)
    assert quiet[1] == pytest.approx(0.0, abs=1e-2)
    assert jump[0] == pytest.approx(math.hypot(0.2, 1 / FPS), abs=1e-3)
    assert jump[1] > 3.0
    assert len(seam_jumps(positions, [0, 1, 59], FPS)) == 0


def test_lean_of_a_lying_body_and_share_of_frozen_frames() -> None:
    upright = statue(40, 0.0)
    assert float(lean(SKELETON, upright).max()) < 10
    tilted = upright[..., [0, 2, 1]]  # lies on its face
    assert float(lean(SKELETON, tilted).min()) > 80
    assert frozen_share(upright, FPS) == 1.0
    assert frozen_share(statue(40), FPS) == 0.0


def test_ranks_of_matching_texts_and_frechet_distance() -> None:
    texts = torch.eye(40)
    labels = [str(number) for number in range(40)]
    assert ranks(texts, texts, labels).tolist() == [0] * 40
    assert ranks(-texts, texts, labels).min() >= 31
    assert ranks(texts, texts, ["same"] * 40).tolist() == [0] * 40  # nothing to be confused with
    cloud = torch.randn(4000, 5, generator=torch.Generator().manual_seed(0))
    assert frechet_distance(cloud, cloud) == pytest.approx(0.0, abs=1e-6)
    assert frechet_distance(cloud, cloud + 2) == pytest.approx(20.0, abs=1e-4)
    assert frechet_distance(cloud, 3 * cloud) == pytest.approx(5 * 4, abs=1.0)
