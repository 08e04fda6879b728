"""Values that cannot be sent are refused where they are made; the error says what was given and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from motiongen_client import (
    InvalidInput,
    JointTargets,
    Keyframe,
    Motion,
    Rig,
    RootTrajectory,
    SessionOptions,
    StartPose,
    UnknownName,
    Waypoint,
)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Waypoint(-1, 0, 0), "frame"),
        (lambda: Waypoint(1.5, 0, 0), "frame"),  # type: ignore[arg-type]
        (lambda: Waypoint(2**53 + 1, 0, 0), "frame"),
        (lambda: Waypoint(1, math.nan, 0), "x_m"),
        (lambda: JointTargets(1, [-1], [[0, 0, 0]]), "joints"),
        (lambda: JointTargets(1, [2**32], [[0, 0, 0]]), "joints"),
        (lambda: RootTrajectory(1, [[1e300, 0]]), "positions_m"),
        (lambda: Waypoint(1, 0, math.inf), "z_m"),
        (lambda: Waypoint(1, 0, "3"), "z_m"),  # type: ignore[arg-type]
        (lambda: Waypoint(1, 0, 10**400), "z_m"),
        (lambda: Waypoint(1, 0, 0, tolerance_m=10**400), "tolerance_m"),
        (lambda: RootTrajectory(0, [[1, 10**400]]), "positions_m"),  # type: ignore[arg-type]
        (lambda: Waypoint(1, 0, 0, heading_rad=math.nan), "heading_rad"),
        (lambda: RootTrajectory(0, np.zeros((4, 3), np.float32)), "positions_m"),
        (lambda: RootTrajectory(0, np.zeros((0, 2), np.float32)), "positions_m"),
        (lambda: RootTrajectory(0, np.full((2, 2), np.nan, np.float32)), "positions_m"),
        (lambda: RootTrajectory(0, [[1, "a"]]), "positions_m"),  # type: ignore[arg-type]
        (lambda: RootTrajectory(0, np.zeros((2, 2), np.float32), np.zeros(3, np.float32)), "headings_rad"),
        (lambda: Keyframe(0, np.zeros(3, np.float32)), "positions_m"),
        (lambda: JointTargets(0, [], np.zeros((0, 3), np.float32)), "joints"),
        (lambda: JointTargets(0, [0, 1], np.zeros((1, 3), np.float32)), "positions_m"),
        (lambda: JointTargets(0, [0], np.zeros((1, 3), np.float32), np.zeros((1, 3), np.float32)), "rotations"),
        (lambda: SessionOptions(seed=-1), "seed"),
        (lambda: SessionOptions(seed=1 << 64), "seed"),
        (lambda: SessionOptions(denoise_steps=0), "denoise_steps"),
        (lambda: SessionOptions(lookahead_frames=-4), "lookahead_frames"),
        (lambda: SessionOptions(text_guidance=math.inf), "text_guidance"),
        (lambda: StartPose(x_m=math.nan), "x_m"),
    ],
)
def test_invalid_values_are_refused_with_field_and_allowed_values(make: Callable[[], object], field: str) -> None:
    with pytest.raises(InvalidInput, match=rf"{field}.*was given; allowed is"):
        make()


def test_lists_are_converted_to_arrays() -> None:
    path = RootTrajectory(3, [[0, 1], [0, 2]])  # type: ignore[arg-type]
    assert path.positions_m.dtype == np.float32


def test_motion_of_a_wrong_width_is_refused(stick_rig: Rig) -> None:
    with pytest.raises(InvalidInput, match=r"\(frames, 43\)"):
        Motion(stick_rig, 0, np.zeros((2, 5), np.float32))


def test_frames_are_found_by_their_absolute_index(stick_rig: Rig, stick_motion: Motion) -> None:
    later = Motion(stick_rig, 100, stick_motion.rows)
    assert later.frame(107).root_translation_m[2] == pytest.approx(0.35)
    assert later.frame(107).time_s == pytest.approx(5.35)
    with pytest.raises(InvalidInput, match="from 100 to 139"):
        later.frame(99)


def test_unknown_joint_error_lists_the_known_joints(stick_rig: Rig) -> None:
    assert stick_rig.index("Head") == 2
    with pytest.raises(UnknownName, match="LeftHand"):
        stick_rig.index("Tail")


def test_repr_of_motion_frame_and_rig_is_one_short_line(stick_motion: Motion) -> None:
    assert repr(stick_motion) == "Motion(frames 0 to 39 of stick9, 2.00 s)"
    assert repr(stick_motion.frame(12)) == "Frame(12 of stick9, 0.60 s, root at 1.00 0.90 0.60 m)"
    assert repr(stick_motion.rig) == "Rig(stick9, 9 joints, 20 Hz)"
