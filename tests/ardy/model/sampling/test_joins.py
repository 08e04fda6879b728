"""Joins: jumps between tokens are smoothed; motion without jumps and the history are left alone."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.sampling.correct import correct_window
from motiongen_ardy.model.sampling.joins import join_operator
from motiongen_ardy.model.sampling.options import SamplingOptions
from tests.ardy.model.sampling.conftest import Stand

JOIN = SamplingOptions(join_tokens=True)


def joined_root(layout: Representation, stand: Stand, moves: Tensor, history: int = 2) -> Tensor:
    """(T, 3) of history and joined frames."""
    features = stand(moves)
    new = correct_window(layout, features[:, :history], features[:, history:], None, JOIN)
    return layout.denormalize(torch.cat([features[:, :history], new], dim=1))[0, :, :3]


def test_constant_speed_and_acceleration_are_left_alone() -> None:
    frames = torch.arange(42.0)
    for curve in (0.3 * frames + 2, 0.05 * frames.square()):
        torch.testing.assert_close(join_operator(2, 40, 8, 4) @ curve, curve[2:], atol=1e-3, rtol=0)


def test_a_jump_between_tokens_is_spread_over_neighbouring_frames(layout: Representation, stand: Stand) -> None:
    moves = torch.zeros(42, 3)
    moves[22:, 2] = 0.08  # frame 22 starts a token
    root = joined_root(layout, stand, moves)[:, 2]
    assert root.diff().max() < 0.3 * 0.08 + 1e-5
    assert root[19].abs() < 1e-5
    assert (root[24] - 0.08).abs() < 1e-5


@pytest.mark.parametrize("history", [1, 2])
def test_a_jump_at_the_seam_fades_out_after_the_history(layout: Representation, stand: Stand, history: int) -> None:
    moves = torch.zeros(40 + history, 3)
    moves[history:, 0] = 0.08
    root = joined_root(layout, stand, moves, history)[:, 0]
    assert (root[:history] == 0).all()
    assert root.diff().max() < 0.5 * 0.08
    assert (root[history + 10 :] - 0.08).abs().max() < 1e-4


def test_a_root_on_its_waypoint_stays_there(layout: Representation, stand: Stand) -> None:
    moves = torch.zeros(42, 3)
    moves[22:, 2] = 0.08
    features = stand(moves)
    targets = Targets(layout.skeleton)
    targets.add_waypoints([22], torch.tensor([[0.0, 0.08]]))
    goals = tuple(part[None] for part in targets.observe(layout, 2, 40))
    new = layout.denormalize(correct_window(layout, features[:, :2], features[:, 2:], (goals[0], goals[1]), JOIN))
    assert (new[0, 20, 2] - 0.08).abs() < 1e-5


def test_short_windows_with_and_without_history_are_joined() -> None:
    for before in (0, 1, 2):
        for new in (1, 2, 4, 5, 8):
            operator = join_operator(before, new, 8, 4)
            assert operator.shape == (new, before + new)
            torch.testing.assert_close(operator.sum(dim=1), torch.ones(new))
