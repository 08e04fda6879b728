"""Ground: standing feet are on it within 5 mm, on slopes and stairs, and no joint jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motiongen_client import InvalidInput, Motion, Playback
from motiongen_client.ground import Ground, GroundFollower, Heights
from motiongen_client.ground.limb_ik import two_bone
from motiongen_client.motion import Frame
from motiongen_client.sampling import Sampler
from tests.client.bodies import FPS, client_rig, walking

RIG = client_rig()
WALK = walking(RIG)
SOLE_M, ANKLE_M = 0.0152, 0.0737
FEET = {"LeftFoot": 0, "RightFoot": 2}


def level(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.zeros_like(x)


def slope(degrees: float, toward_x: float = 0.0) -> Heights:
    """A slope that rises in the direction of the walk, and by toward_x to the left."""
    rise = np.tan(np.radians(degrees))
    return lambda x, z: rise * z + toward_x * x


def steps(height_m: float, every_m: float = 0.6) -> Heights:
    """Stairs whose treads are where the feet come to stand."""
    return lambda x, z: height_m * np.floor((z + 0.26) / every_m)


def hills(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    return 0.08 * np.sin(1.7 * z) + 0.05 * np.cos(2.1 * x)


GROUNDS = {
    "up": slope(12),
    "down": slope(-12),
    "across": slope(0, 0.15),
    "steep": slope(20),
    "stairs up": steps(0.12),
    "stairs down": steps(-0.12),
    "hills": hills,
}


def off_ground(motion: Motion, heights: Heights) -> np.ndarray:
    """How far ankle and toes of each standing foot are off their height above the ground, in metres."""
    joints, contact = motion.joint_positions_m().astype(np.float64), motion.foot_contact
    errors = []
    for name, column in FEET.items():
        standing = contact[:, column] > 0.5
        for joint, above in zip(RIG.limbs[name], (ANKLE_M, SOLE_M), strict=True):
            place = joints[standing, joint]
            errors.append(place[:, 1] - above - heights(place[:, 0], place[:, 2]))
    return np.concatenate(errors)


def turned_rad(motion: Motion) -> np.ndarray:
    """(T - 1, J) how far each joint turns from frame to frame."""
    turns = motion.joint_rotation_quat_wxyz.astype(np.float64)
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    return 2 * np.arccos(np.minimum(np.abs((turns[1:] * turns[:-1]).sum(axis=-1)), 1.0))


def test_synthetic_walk_stands_on_level_ground() -> None:
    assert np.abs(off_ground(WALK, level)).max() < 1e-3


def test_level_ground_does_not_change_joint_positions() -> None:
    found = Ground(RIG, level).apply(WALK)
    np.testing.assert_allclose(found.joint_positions_m(), WALK.joint_positions_m(), atol=2e-4)


@pytest.mark.parametrize("name", GROUNDS)
def test_standing_feet_are_on_the_ground_within_5_mm(name: str) -> None:
    found = Ground(RIG, GROUNDS[name]).apply(WALK)
    assert np.abs(off_ground(found, GROUNDS[name])).max() < 0.005


@pytest.mark.parametrize("name", GROUNDS)
def test_ground_makes_no_joint_jump(name: str) -> None:
    found = Ground(RIG, GROUNDS[name]).apply(WALK)
    assert (turned_rad(found) - turned_rad(WALK)).max() < 0.35
    moved, flat = (np.diff(each.joint_positions_m(), axis=0) for each in (found, WALK))
    # a foot that is lifted 0.44 m in the 8 frames of a stride, the most here, rises evenly by 0.055 m a frame
    assert np.abs(moved - flat)[..., 1].max() < 2 * 0.055
    assert np.abs(np.diff(found.root_translation_m[:, 1], n=2)).max() < 0.02, "the hips rise and fall evenly"


@pytest.mark.parametrize("name", GROUNDS)
def test_foot_in_the_air_does_not_go_through_the_ground(name: str) -> None:
    found = Ground(RIG, GROUNDS[name]).apply(WALK)
    joints = found.joint_positions_m().astype(np.float64)
    for limb, column in FEET.items():
        known_to = np.flatnonzero(found.foot_contact[:, column])[-1]  # it is not known where the last step ends
        toes = joints[:known_to][found.foot_contact[:known_to, column] < 0.5, RIG.limbs[limb][1]]
        assert (toes[:, 1] - GROUNDS[name](toes[:, 0], toes[:, 2])).min() > -0.005


def test_standing_feet_do_not_slide_on_a_slope() -> None:
    found = Ground(RIG, GROUNDS["up"]).apply(WALK)
    for limb, column in FEET.items():
        standing = found.foot_contact[:, column] > 0.5
        ankle = found.joint_positions_m()[:, RIG.limbs[limb][0]]
        still = standing[1:] & standing[:-1]
        assert np.linalg.norm(np.diff(ankle, axis=0)[still], axis=1).max() < 0.002


def test_only_leg_rotations_and_the_height_of_the_root_change() -> None:
    found = Ground(RIG, GROUNDS["stairs up"]).apply(WALK)
    changed = {RIG.joint_names[joint] for joint in np.flatnonzero(
        np.abs(found.joint_rotation_quat_wxyz - WALK.joint_rotation_quat_wxyz).max(axis=(0, 2)) > 1e-6
    )}  # fmt: skip
    assert changed <= {"LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot"}
    np.testing.assert_array_equal(found.root_translation_m[:, [0, 2]], WALK.root_translation_m[:, [0, 2]])


@pytest.mark.parametrize("name", ["up", "stairs up", "hills"])
def test_played_frames_follow_the_ground_as_the_whole_motion_does(name: str) -> None:
    ground, playback = Ground(RIG, GROUNDS[name]), Playback(FPS, RIG.row_width)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, WALK.rows, 80)
    whole = ground.apply(WALK)
    follower = GroundFollower(ground, playback)
    shown = [follower.frame(Frame(RIG, index, playback.row(index))).row for index in range(60)]
    played = Motion(RIG, 0, np.stack(shown))
    assert np.abs(off_ground(played, GROUNDS[name])).max() < 0.005
    difference = played.joint_positions_m() - whole.joint_positions_m()[:60]
    assert np.abs(difference).max() < 0.03
    assert (turned_rad(played) - turned_rad(WALK)[:59]).max() < 0.35


def test_replan_makes_no_joint_jump() -> None:
    ground, playback = Ground(RIG, GROUNDS["stairs up"]), Playback(FPS, RIG.row_width)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, WALK.rows[:40], 20)
    follower = GroundFollower(ground, playback)
    shown = [follower.frame(Frame(RIG, index, playback.row(index))).row for index in range(24)]
    slower = WALK.rows[24:64].copy()  # the same poses on another path: it bends to the left
    slower[:, 0] += 0.03 * np.arange(40)
    playback.announce_plan(2, 24)
    playback.add_chunk(2, 24, slower, 60)
    shown += [follower.frame(Frame(RIG, index, playback.row(index))).row for index in range(24, 50)]
    played = Motion(RIG, 0, np.stack(shown))
    assert (turned_rad(played) - turned_rad(WALK)[:49]).max() < 0.35


@pytest.mark.parametrize("at", [27, 31])
def test_replan_onto_another_height_in_mid_step_is_faded(at: int) -> None:
    """Without it, a foot in the air would jump by 0.2 m, its joints by 0.4 and 1.1 rad, and at 27 the hips by 0.1 m."""
    ledge: Heights = lambda x, z: np.where(x > 0.35, 0.2, 0.0)  # noqa: E731
    ground, playback = Ground(RIG, ledge), Playback(FPS, RIG.row_width)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, WALK.rows[:60], 20)
    follower = GroundFollower(ground, playback)
    shown = [follower.frame(Frame(RIG, index, playback.row(index))).row for index in range(at)]
    aside = WALK.rows[at : at + 40].copy()
    aside[:, 0] += 0.06 * np.arange(1, 41)
    playback.announce_plan(2, at)
    playback.add_chunk(2, at, aside, at + 30)
    shown += [follower.frame(Frame(RIG, index, playback.row(index))).row for index in range(at, at + 8)]
    played = Motion(RIG, 0, np.stack(shown))
    lifted_m = np.abs(np.diff(played.joint_positions_m()[:, :, 1], axis=0))[at - 1]
    assert lifted_m.max() < 0.1
    assert np.abs(np.diff(played.root_translation_m[:, 1]))[at - 1] < 0.05
    assert turned_rad(played)[at - 1].max() < 0.25


@pytest.mark.parametrize("name", ["up", "stairs up"])
def test_poses_between_frames_stand_on_the_ground_and_do_not_jump(name: str) -> None:
    ground, playback = Ground(RIG, GROUNDS[name]), Playback(FPS, RIG.row_width)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, WALK.rows, 80)
    sampler, follower, hertz = Sampler(RIG, playback), GroundFollower(ground, playback), 120
    shown = []
    for tick in range(2 * hertz):
        playback.advance(tick / hertz)
        share, row = sampler.row(tick / hertz)
        shown.append(follower.frame(Frame(RIG, playback.playhead, row, share=share)).row.copy())
        # in contact only if both neighbouring frames are
        shown[-1][-4:] = WALK.foot_contact[playback.playhead : playback.playhead + 2].min(axis=0)
    played = Motion(RIG, 0, np.stack(shown))
    assert np.abs(off_ground(played, GROUNDS[name])).max() < 0.006
    moved = np.diff(played.joint_positions_m(), axis=0)
    frames = np.diff(ground.apply(WALK).joint_positions_m(), axis=0)
    assert np.abs(moved).max() < np.abs(frames).max() * FPS / hertz * 1.5


@pytest.mark.parametrize("at", [30, 36])
def test_ground_beyond_a_cut_does_not_affect_frames_before_it(at: int) -> None:
    """At 36 the cut is known when the frames before it are computed, eight at once."""
    high: Heights = lambda x, z: np.where(x > 5, 10.0, 0.0)  # noqa: E731
    ground, playback = Ground(RIG, high), Playback(FPS, RIG.row_width)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, WALK.rows[:40], at)
    elsewhere = WALK.rows[at : at + 40].copy()
    elsewhere[:, 0] += 10
    follower = GroundFollower(ground, playback)
    shown = [follower.frame(Frame(RIG, index, playback.row(index))).row for index in range(25)]
    playback.announce_plan(2, at, is_cut=True)
    playback.add_chunk(2, at, elsewhere, at + 30)
    shown += [follower.frame(Frame(RIG, index, playback.row(index))).row for index in range(25, at + 30)]
    up = np.stack(shown)[:, 1] - np.concatenate([WALK.rows[:at], elsewhere[:30]])[:, 1]
    assert np.abs(up[:at]).max() < 0.002
    assert np.abs(up[at:] - 10).max() < 0.002


def test_leg_too_short_points_at_its_goal_and_straight_leg_bends_forward() -> None:
    hip, knee, ankle = (np.array([[0.0, y, 0.0]]) for y in (1.0, 0.5, 0.0))
    ahead = np.array([[0.0, 0.0, 1.0]])
    first, second = two_bone(hip, knee, ankle, np.array([[0.0, -5.0, 0.0]]), ahead)
    end = hip + first[0] @ (knee - hip)[0] + second[0] @ (ankle - knee)[0]
    np.testing.assert_allclose(end, [[0.0, 0.0, 0.0]], atol=1e-3)
    first, second = two_bone(hip, knee, ankle, np.array([[0.0, 0.2, 0.0]]), ahead)
    bent = hip + first[0] @ (knee - hip)[0]
    assert bent[0, 2] > 0.1
    np.testing.assert_allclose(bent + second[0] @ (ankle - knee)[0], [[0.0, 0.2, 0.0]], atol=1e-9)


def test_invalid_heights_and_rigs_without_legs_or_toes_are_refused() -> None:
    with pytest.raises(InvalidInput, match="one for each x and z"):
        Ground(RIG, lambda x, z: np.zeros(3)).apply(WALK)
    with pytest.raises(InvalidInput, match="finite"):
        Ground(RIG, lambda x, z: x * np.nan).apply(WALK)
    with pytest.raises(InvalidInput, match="a thigh and a shin"):
        Ground(client_rig("g134"), level)
    with pytest.raises(InvalidInput, match="toes"):
        Ground(replace(RIG, limbs={**RIG.limbs, "LeftFoot": RIG.limbs["LeftFoot"][:1]}), level)
