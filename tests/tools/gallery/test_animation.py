"""Animations: their figures, the millimetres that a page reads, and positions that are refused."""

from __future__ import annotations

import base64

import numpy as np
import pytest

from motiongen_client import InvalidInput
from motiongen_tools.gallery.animation import LONGEST_S, Animation, Goal, refused

NAMES = ("Hips", "LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase")


def walking(num_frames: int, mps: float = 1.0, **more: object) -> Animation:
    """All joints move along +Z together, far from the origin, at 20 frames a second."""
    positions = np.zeros((num_frames, 5, 3), np.float32)
    positions[..., 0], positions[..., 1] = 50.0, 0.9
    positions[..., 2] = -30.0 + mps / 20 * np.arange(num_frames)[:, None]
    contacts = np.ones((num_frames, 4), bool)
    return Animation(positions, contacts, (1, 2, 3, 4), (-1, 0, 1, 0, 3), NAMES, 20, **more)  # type: ignore[arg-type]


def test_a_page_gets_millimetres_relative_to_the_start_of_the_take() -> None:
    goal = Goal(3, np.array([[50.5, 0.01, -29.0]], np.float32))
    shown = walking(40, goals=(goal,)).shown()
    numbers = np.frombuffer(base64.b64decode(shown["data"]), "<i2").reshape(40, 5, 3)
    assert numbers[0].tolist() == [[0, 900, 0]] * 5
    assert numbers[-1, 0].tolist() == [0, 900, 1950]
    assert shown["goals"] == [{"frame": 3, "points": [[0.5, 0.01, 1.0]], "is_path": False}]
    assert shown["sides"] == ["middle", "left", "left", "right", "right"]


def test_a_long_take_is_cut_and_the_frames_left_out_are_counted() -> None:
    shown = walking(1000).shown()
    assert shown["num_frames"] == LONGEST_S * 20
    assert shown["left_out"] == 1000 - LONGEST_S * 20


def test_feet_slide_only_while_labelled_as_in_contact() -> None:
    sliding = walking(40, mps=0.5)
    assert sliding.slide_mps() == pytest.approx(0.5, abs=1e-3)
    assert sliding.speed_mps() == pytest.approx(0.5, abs=1e-3)
    lifted = Animation(
        sliding.positions_m, np.zeros((40, 4), bool), sliding.feet, sliding.parents, sliding.joint_names, 20
    )
    assert lifted.slide_mps() == 0


@pytest.mark.parametrize("positions", [np.zeros((0, 5, 3)), np.zeros((2, 4, 3)), np.full((2, 5, 3), np.nan)])
def test_invalid_positions_are_refused(positions: np.ndarray) -> None:
    with pytest.raises(InvalidInput, match="positions_m"):
        Animation(positions.astype(np.float32), np.ones((len(positions), 4), bool), (), (-1, 0, 1, 0, 3), NAMES, 20)


def test_a_refused_take_has_no_frames() -> None:
    assert refused("no such joint") == {"num_frames": 0, "detail": "no such joint", "verdict": "refused"}
