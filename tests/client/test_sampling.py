"""Poses between frames: shortest rotations at an even pace, jumps that fade, and time scales."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_client import InvalidInput, MotionClient, Playback, Rig
from motiongen_client.kinematics import quaternion_to_matrix
from motiongen_client.sampling import Sampler, between_rows, inverse, product, slerp
from tests.client.conftest import ManualClock
from tests.client.synthetic import synthetic_rows
from tests.client.waiting import until

UNIT = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(x * x for x in q) > 0.1)


def unit(values: list[float]) -> np.ndarray:
    quaternion = np.array(values, np.float32)
    return quaternion / np.linalg.norm(quaternion)


def angle_rad(first: np.ndarray, second: np.ndarray) -> float:
    return 2 * math.acos(min(1.0, abs(float(first.astype(np.float64) @ second))))


@settings(deadline=None)
@given(UNIT, UNIT, st.floats(0, 1))
def test_slerp_turns_by_the_given_share_of_the_shortest_rotation(
    one: list[float], other: list[float], share: float
) -> None:
    first, second = unit(one), unit(other)
    mixed = slerp(first, second, share)
    assert np.linalg.norm(mixed) == pytest.approx(1, abs=1e-5)
    whole = angle_rad(first, second)
    assert angle_rad(first, mixed) == pytest.approx(share * whole, abs=3e-3)
    assert angle_rad(mixed, second) == pytest.approx((1 - share) * whole, abs=3e-3)


@settings(deadline=None)
@given(UNIT, UNIT)
def test_quaternion_product_equals_the_matrix_product(one: list[float], other: list[float]) -> None:
    first, second = unit(one), unit(other)
    matrices = quaternion_to_matrix(first) @ quaternion_to_matrix(second)
    assert quaternion_to_matrix(product(first, second)) == pytest.approx(matrices, abs=1e-5)
    assert abs(product(first, inverse(first))[0]) == pytest.approx(1, abs=1e-5)


def test_root_is_interpolated_linearly_and_contacts_are_of_the_nearer_frame(stick_rig: Rig) -> None:
    earlier, later = synthetic_rows(1, 4, 2)
    later[-4:] = 1
    row = between_rows(stick_rig, earlier, later, 0.25)
    assert row[:3] == pytest.approx(0.75 * earlier[:3] + 0.25 * later[:3])
    assert list(row[-4:]) == [0] * 4
    assert list(between_rows(stick_rig, earlier, later, 0.75)[-4:]) == [1] * 4


@pytest.fixture
def playback(stick_rig: Rig) -> Playback:
    playback = Playback(stick_rig.frame_rate_hz, stick_rig.row_width)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, synthetic_rows(1, 0, 10), 0)
    playback.advance(0.0)
    return playback


def test_sampled_motion_is_even_between_frames(stick_rig: Rig, playback: Playback) -> None:
    sampler, depths = Sampler(stick_rig, playback), []
    for tick in range(40):
        playback.advance(tick / 100)
        depths.append(sampler.row(tick / 100)[1][2])
    assert depths == pytest.approx([0.05 * tick / 5 for tick in range(40)], abs=1e-5)


def test_replan_fades_in_from_the_pose_shown(stick_rig: Rig, playback: Playback) -> None:
    sampler = Sampler(stick_rig, playback, blend_s=0.1)
    playback.advance(0.02)
    before = sampler.row(0.02)[1]
    playback.announce_plan(2, 1)
    playback.add_chunk(2, 1, synthetic_rows(9, 1, 9), 0)  # x is the plan's number: eight metres away
    seen = []
    for tick in range(2, 16):
        playback.advance(tick / 100)
        seen.append(sampler.row(tick / 100)[1][0])
    assert seen[0] == pytest.approx(before[0], abs=1e-4), "it begins at the pose shown before"
    assert max(np.diff(seen)) < 2.0
    assert seen[-1] == pytest.approx(9, abs=1e-4)
    assert sorted(seen) == seen


def test_cut_is_not_interpolated_and_is_forgotten_when_replaced(stick_rig: Rig, playback: Playback) -> None:
    sampler = Sampler(stick_rig, playback, blend_s=0.1)
    before = sampler.row(0.0)[1]
    playback.announce_plan(2, 2, is_cut=True)
    playback.add_chunk(2, 2, synthetic_rows(9, 2, 8), 0)
    seen = []
    for tick in range(1, 16):
        playback.advance(tick / 100)
        seen.append(sampler.row(tick / 100)[1][0])
    assert set(np.round(seen, 3)) == {np.round(before[0], 3), np.float32(9.0)}
    assert playback.is_cut(2)
    assert (playback.cut_before(3), playback.cut_before(2)) == (2, None)
    playback.announce_plan(3, 8, is_cut=True)
    playback.announce_plan(4, 8)
    assert playback.cut_before(9) == 2, "a later plan has replaced the cut not yet shown"


def test_pose_does_not_jump_after_an_underrun(stick_rig: Rig, playback: Playback) -> None:
    sampler = Sampler(stick_rig, playback, blend_s=0.1)
    for tick in range(70):
        playback.advance(tick / 100)
        last = sampler.row(tick / 100)[1]
    assert playback.underruns > 0
    rows = synthetic_rows(1, 10, 20)
    rows[:, 0] += 4  # the frames after the underrun are elsewhere
    playback.add_chunk(1, 10, rows, 0)
    playback.advance(0.7)
    assert sampler.row(0.7)[1][:3] == pytest.approx(last[:3], abs=0.06)


def test_time_scale_sets_the_pace_and_must_be_above_0_and_finite(playback: Playback) -> None:
    playback.set_time_scale(0.5)
    playback.advance(0.0)
    playback.advance(0.45)
    assert playback.playhead == 4
    for wrong in (0.0, -1.0, math.inf):
        with pytest.raises(InvalidInput, match="pause"):
            playback.set_time_scale(wrong)


async def test_sample_is_of_the_current_moment(clock: ManualClock, client: MotionClient) -> None:
    session = await client.open("a person walks")
    await until(lambda: session.playback.buffered_to > 10)
    assert (await until(session.sample)).index == 0
    clock.advance(0.034)  # at 100 frames a second
    sample = session.sample()
    assert sample is not None
    assert (sample.index, sample.share) == (3, pytest.approx(0.4))
    assert sample.time_s == pytest.approx(0.034)
    assert sample.root_translation_m[2] == pytest.approx(0.05 * 3.4)
    assert sample.joint_positions_m()[0][2] == pytest.approx(0.05 * 3.4)
