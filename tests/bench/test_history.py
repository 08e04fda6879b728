"""Seams are found where windows meet, and kept tokens lead to the same motion as encoding again about does."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_server.runner import TorchRunner
from tests.bench.history import make_characters, seams, walk
from tests.bench.models import bench_model

TINY = bench_model("tiny")


@pytest.mark.parametrize(("stride", "kept"), [(40, True), (24, True), (26, False)])
def test_characters_go_on_for_a_stride_at_a_time(stride: int, kept: bool) -> None:
    runner = TorchRunner(TINY.model, "tiny")
    features = walk(runner, make_characters(TINY, 3, 2, stride, kept), num_windows=3)
    assert features.shape == (3, 3 * stride, TINY.model.representation.feature_dim)
    assert np.isfinite(features).all()


def test_a_jump_of_the_root_shows_at_the_seam_alone() -> None:
    layout = TINY.model.representation
    features = np.zeros((2, 80, layout.feature_dim), np.float32)
    smooth = seams(TINY, features, 40, kept=True)
    features[:, 40:, 0] += 0.1  # x of the root, metres: the statistics of random weights are 0 and 1
    jumped = seams(TINY, features, 40, kept=True)
    assert smooth.root_cm == pytest.approx((0.0, 0.0), abs=1e-3)
    assert jumped.root_cm == pytest.approx((10.0, 10.0), rel=1e-3)
    assert jumped.root_inside_cm == pytest.approx((0.0, 0.0), abs=1e-3)
