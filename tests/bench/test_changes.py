"""Measuring abrupt changes of motion: they are found with their frame, however the root moves."""

from __future__ import annotations

import numpy as np
import pytest

from tests.bench.changes import FPS, Order, changes, measured, table

HIPS = (1, 2)
JUMP_AT = 50


def gliding(num_frames: int = 80) -> np.ndarray:
    """A root that moves forward at 2 m/s, with hips to its sides and a foot below it."""
    joints_m = np.zeros((num_frames, 4, 3))
    joints_m[:, :, 2] = 2.0 / FPS * np.arange(num_frames)[:, None]
    joints_m[:, 1, 0], joints_m[:, 2, 0], joints_m[:, 0, 1] = -0.1, 0.1, 0.9
    return joints_m


def test_steady_motion_has_no_acceleration_and_no_hip_turn() -> None:
    figures = measured(gliding(), HIPS, seed=3)
    assert figures.seed == 3
    assert figures.hardest == pytest.approx(0.0, abs=1e-9)
    assert figures.hips == pytest.approx(0.0, abs=1e-9)


def test_jumping_foot_and_hips_are_found_with_their_frames() -> None:
    joints_m = gliding()
    joints_m[JUMP_AT:, 3, 0] += 0.4
    joints_m[JUMP_AT:, 1, 2] += 0.1
    figures = measured(joints_m, HIPS, seed=0)
    assert figures.hardest == pytest.approx(0.4 * FPS**2)
    assert figures.hardest_at in (JUMP_AT - 1, JUMP_AT)
    assert figures.hips == pytest.approx(np.arctan(0.5) * FPS)
    assert figures.hips_at == JUMP_AT
    lines = table({"still": [measured(gliding(), HIPS, 0)], "torn": [figures]}).splitlines()
    assert lines[2].startswith("| torn |")
    assert lines[-1] == "harder than 100: 1, than 80: 1"


def test_every_change_has_two_different_orders() -> None:
    assert all(first != Order() != then for first, then in changes().values())
