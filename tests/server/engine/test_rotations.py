"""Quaternions to matrices: a few are converted one by one, to the same numbers."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_server.engine.types.rotations import FEW, rotation_matrices, rotation_matrices_of_few


@pytest.mark.parametrize("count", [0, 1, 3, FEW, FEW + 1])
def test_few_quaternions_give_the_same_matrices_bit_for_bit(count: int) -> None:
    numbers = np.random.default_rng(count)
    for length in (1.0, 0.9995, 37.0):
        quaternions = length * numbers.normal(size=(count, 4))
        few = rotation_matrices_of_few(quaternions)
        assert few.shape == (count, 3, 3)
        np.testing.assert_array_equal(few, rotation_matrices(quaternions))
