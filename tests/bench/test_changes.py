"""Changes: what happens in one frame is found, with its frame, whatever the root does meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from tests.bench.changes import FPS, Order, changes, measured, table

HIPS = (1, 2)
JUMP_AT = 50


def gliding(num_frames: int = 80) -> np.ndarray:
    """A root that goes ahead at 2 m/s, its hips aside, a foot below it."""
    joints_m = np.zeros((num_frames, 4, 3))
    joints_m[:, :, 2] = 2.0 / FPS * np.arange(num_frames)[:, None]
    joints_m[:, 1, 0], joints_m[:, 2, 0], joints_m[:, 0, 1] = -0.1, 0.1, 0.9
    return joints_m


def test_who_glides_has_nothing() -> None:
    figures = measured(gliding(), HIPS, seed=3)
    assert figures.seed == 3
    assert figures.hardest == pytest.approx(0.0, abs=1e-9)
    assert figures.hips == pytest.approx(0.0, abs=1e-9)


def test_a_foot_that_is_elsewhere_at_once_and_hips_that_jump_are_found() -> None:
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


def test_each_change_is_told_something_twice() -> None:
    assert all(first != Order() != then for first, then in changes().values())
