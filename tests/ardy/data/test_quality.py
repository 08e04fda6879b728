"""The figures of a motion, of motions for which they are known."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.data.poses import global_pose
from motiongen_ardy.data.quality import Quality, quality

CORE = load_skeleton("core27")
FPS = 20
FRAMES = 40
SECONDS = np.arange(FRAMES) / FPS


def standing() -> tuple[np.ndarray, np.ndarray]:
    """Quaternions and root of the neutral pose, with the lowest foot joint at height 0."""
    quaternions = np.zeros((FRAMES, CORE.num_joints, 4))
    quaternions[..., 0] = 1
    root = np.zeros((FRAMES, 3))
    feet = global_pose(CORE, quaternions, root)[1][:, list(CORE.contact_joints)]
    root[:, 1] = -feet[..., 1].min()
    return quaternions, root


def moved(x_m: np.ndarray | float = 0.0, y_m: np.ndarray | float = 0.0, z_m: np.ndarray | float = 0.0) -> Quality:
    quaternions, root = standing()
    return quality(CORE, quaternions, root + np.stack(np.broadcast_arrays(x_m, y_m, z_m, SECONDS)[:3], axis=-1), FPS)


def test_a_body_that_stands_has_no_fault() -> None:
    figures = moved()
    assert figures.rounded() == dict.fromkeys(vars(figures), 0.0)


def test_a_body_that_slides_slowly_on_the_ground_skates() -> None:
    figures = moved(x_m=0.12 * SECONDS, z_m=0.16 * SECONDS)
    assert figures.skate_m_s == pytest.approx(0.2)
    assert figures.slowest_ratio == figures.slowest_p90 == 0, "it does not move fast enough to walk"


def test_a_body_that_glides_does_not_touch_the_ground_and_its_slowest_foot_is_as_fast_as_it() -> None:
    figures = moved(z_m=1.5 * SECONDS)
    assert figures.skate_m_s == 0
    assert (figures.slowest_ratio, figures.slowest_p90) == pytest.approx((1, 1))
    quickening = moved(z_m=np.where(SECONDS < 1.75, 0, SECONDS - 1.75))
    assert (quickening.slowest_ratio, quickening.slowest_p90) == pytest.approx((1, 1)), "only moving frames count"


def test_a_floating_body_is_lifted_and_does_not_skate() -> None:
    figures = moved(x_m=0.2 * SECONDS, y_m=0.5)
    assert figures.lowest_m == pytest.approx(0.5)
    assert figures.lifted_m == pytest.approx(0.5)
    assert figures.skate_m_s == 0
    sinking = moved(y_m=np.where(SECONDS == 0.5, -0.3, 0.0))
    assert (sinking.lowest_m, sinking.lifted_m) == pytest.approx((-0.3, 0)), "one low frame floats no less"


def test_acceleration_is_of_the_joints() -> None:
    assert moved(z_m=0.5 * 3.0 * SECONDS**2).acceleration == pytest.approx(3.0)


@pytest.mark.parametrize("chain", [CORE.left_foot, CORE.right_foot])
def test_the_turn_of_either_knee_is_the_largest_from_frame_to_frame(chain: tuple[int, ...]) -> None:
    quaternions, root = standing()
    angle = np.radians(np.minimum(2.0 * np.arange(FRAMES), 40.0))
    angle[30:] += np.radians(25)
    quaternions[:, CORE.parents[chain[0]], :2] = np.stack([np.cos(angle / 2), np.sin(angle / 2)], axis=-1)
    assert quality(CORE, quaternions, root, FPS).knee_deg == pytest.approx(25)
    hip = CORE.parents[CORE.parents[chain[0]]]
    for joint in (0, hip):
        turned, _ = standing()
        turned[20:, joint] = np.cos(0.5), 0, np.sin(0.5), 0
        assert quality(CORE, turned, root, FPS).knee_deg == pytest.approx(0, abs=1e-4), "the knee moves as a whole"
