"""Corrections spread over time: exact where they are known, zero far from there, smooth between."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.model.sampling.spread import spread, within


def known_at(*frames: int, num_frames: int = 41) -> Tensor:
    known = torch.zeros(1, num_frames, 1, dtype=torch.bool)
    known[0, list(frames)] = True
    return known


def test_one_value_fades_in_and_out_over_its_reach() -> None:
    values = torch.full((1, 41, 1, 3), 9.0)
    values[0, 20] = 2.0
    curve = spread(values, known_at(20), 8)[0, :, 0, 0]
    assert curve[20] == 2.0
    assert (curve[:13] == 0).all()
    assert (curve[28:] == 0).all()
    assert (curve[12:21].diff() >= 0).all()
    assert curve.diff().diff().abs().max() < 2.0 * 6 / 8**2


def test_nearby_values_blend_into_each_other() -> None:
    values = torch.zeros(1, 41, 1, 1)
    values[0, 10], values[0, 16] = 1.0, 3.0
    curve = spread(values, known_at(10, 16), 8)[0, :, 0, 0]
    assert curve[10] == 1.0
    assert curve[16] == 3.0
    assert float(curve[13]) == 2.0
    assert (curve[10:17] >= 1.0).all()


def test_channels_and_rows_do_not_mix() -> None:
    values, known = torch.ones(2, 9, 2, 1), torch.zeros(2, 9, 2, dtype=torch.bool)
    known[1, 4, 0] = True
    curve = spread(values, known, 3)
    assert curve[1, 4, 0] == 1.0
    assert (curve[0] == 0).all()
    assert (curve[1, :, 1] == 0).all()


def test_within_marks_the_frames_in_reach_of_a_known_one() -> None:
    near = within(known_at(5, num_frames=12), 2)[0, :, 0]
    assert near.nonzero().flatten().tolist() == [3, 4, 5, 6, 7]
