"""The root projected onto its goals: exact there, smooth between them, unchanged where there are none."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.sampling.goal_curves import goal_curves
from motiongen_ardy.model.sampling.options import SamplingOptions
from motiongen_ardy.model.sampling.projection import RootProjection, make_projection

TINY = Path(__file__).parents[3] / "data" / "golden" / "tiny-core27" / "checkpoint"
HISTORY, HORIZON = 16, 40
OPTIONS = SamplingOptions(project_root=True, plan_root=True)


@pytest.fixture(scope="module")
def layout() -> Representation:
    return load_checkpoint(TINY).representation


def made(layout: Representation, targets: Targets, options: SamplingOptions = OPTIONS) -> RootProjection | None:
    observed, mask = (part[None] for part in targets.observe(layout, 0, HISTORY + HORIZON + 20))
    planned = targets.planned_frames(0, HISTORY + HORIZON + 20)[None]
    before = torch.zeros(1, 4)
    return make_projection(
        layout, observed, mask, planned, first=HISTORY, num_frames=HORIZON, options=options, before=before
    )


def walk(layout: Representation) -> Tensor:
    """A normalised root (1, HORIZON, 5) that walks forward at 1 m/s and faces forward."""
    root = torch.zeros(1, HORIZON, ROOT_WIDTH)
    root[..., 1], root[..., 2], root[..., 3] = 0.9, torch.arange(1, HORIZON + 1) / 20, 1.0
    return layout.root_stats.normalize(root)


def projected(layout: Representation, targets: Targets, options: SamplingOptions = OPTIONS) -> Tensor:
    projection = made(layout, targets, options)
    assert projection is not None
    return layout.root_stats.denormalize(projection.apply(layout, walk(layout)))[0]


def test_goals_are_met_and_later_frames_move_with_them(layout: Representation) -> None:
    targets = Targets(layout.skeleton)
    targets.add_waypoints([HISTORY + 19, HISTORY + 29], torch.tensor([[0.3, 0.8], [0.4, 1.7]]))
    targets.height[HISTORY + 29] = np.float32(0.8)
    root = projected(layout, targets)
    assert torch.allclose(root[[19, 29]][:, [0, 2]], torch.tensor([[0.3, 0.8], [0.4, 1.7]]), atol=1e-4)
    assert float(root[29, 1]) == pytest.approx(0.8, abs=1e-4)
    assert torch.allclose(root[30:, 0], torch.full((10,), 0.4), atol=1e-4)
    bend = (root[2:, [0, 2]] - 2 * root[1:-1, [0, 2]] + root[:-2, [0, 2]]).norm(dim=-1) * 400
    assert float(bend.max()) < 6.0
    assert float(root[0, [0]].abs()) < 0.01


def test_headings_turn_the_short_way_to_their_targets(layout: Representation) -> None:
    targets = Targets(layout.skeleton)
    targets.add_heading([HISTORY + 19, HISTORY + 39], torch.tensor([2.5, -2.5]))
    root = projected(layout, targets)
    angle = np.unwrap(torch.atan2(root[:, 4], root[:, 3]).numpy())
    assert angle[19] == pytest.approx(2.5, abs=1e-3)
    assert angle[39] == pytest.approx(math.tau - 2.5, abs=1e-3)
    assert torch.allclose(root[:, [0, 2]], layout.root_stats.denormalize(walk(layout))[0][:, [0, 2]], atol=1e-6)


def test_the_root_may_sway_about_planned_places_but_not_requested_ones(layout: Representation) -> None:
    targets = Targets(layout.skeleton)
    targets.add_waypoints([HISTORY + 19], torch.tensor([[0.02, 1.0]]), torch.tensor([0.1]))
    targets.planned, targets.faced = {HISTORY + 19}, {HISTORY + 19}
    projection = made(layout, targets)
    assert projection is not None
    assert torch.equal(projection.apply(layout, walk(layout)), walk(layout))
    targets.add_waypoints([HISTORY + 19], torch.tensor([[0.02, 1.0]]))
    assert float(projected(layout, targets)[19, 0]) == pytest.approx(0.02, abs=1e-4)


def test_rows_that_are_inactive_or_without_goals_are_unchanged(layout: Representation) -> None:
    targets = Targets(layout.skeleton)
    targets.add_waypoints([HISTORY + 9], torch.tensor([[1.0, 1.0]]))
    projection = made(layout, targets)
    assert projection is not None
    both = RootProjection.stacked([projection.rows(0), projection.rows(0).none()])
    root = walk(layout).expand(2, -1, -1)
    moved = both.apply(layout, root)
    assert not torch.equal(moved[0], root[0])
    assert torch.equal(moved[1], root[1])
    assert torch.equal(both.apply(layout, root, torch.zeros(2)), root)
    targets = Targets(layout.skeleton)
    targets.add_waypoints([HISTORY + HORIZON + 3], torch.tensor([[1.0, 1.0]]))
    assert made(layout, targets) is None


def test_without_a_plan_a_goal_that_is_too_far_is_missed(layout: Representation) -> None:
    targets = Targets(layout.skeleton)
    targets.add_waypoints([HISTORY + 3], torch.tensor([[5.0, 0.0]]))
    root = projected(layout, targets, SamplingOptions(project_root=True))
    assert float(root[3, 0]) < 0.2


@pytest.mark.parametrize("goals", [(0,), (39,), (3, 8, 13, 39), tuple(range(40)), (0, 1, 30)])
def test_curves_are_one_at_their_goal_and_zero_at_the_others(goals: tuple[int, ...]) -> None:
    curves = goal_curves(goals, 40)
    assert curves[list(goals)][:, list(goals)] == pytest.approx(np.eye(len(goals)), abs=1e-9)
    assert np.abs(curves[:, [g for g in range(40) if g not in goals]]).max(initial=0.0) == 0.0
    assert curves[goals[-1] :].sum(axis=1) == pytest.approx(1.0)


def test_curves_are_cubics_with_continuous_acceleration() -> None:
    goals = (7, 18, 33)
    values = goal_curves(goals, 40)[:, list(goals)] @ np.array([0.3, -0.2, 0.5])
    whole = np.concatenate([[0.0], values[: goals[-1] + 1]])  # frame 0 is of the history
    knots = (0, *(goal + 1 for goal in goals))
    pieces = [whole[first : last + 1] for first, last in pairwise(knots)]
    for piece in pieces:
        assert np.diff(piece, n=4) == pytest.approx(0.0, abs=1e-12)
    # A jump of acceleration at a goal would be a change beyond that of the cubics on its sides.
    own = max(np.abs(np.diff(piece, n=3)).max() for piece in pieces)
    assert np.abs(np.diff(whole, n=3)).max() <= own + 1e-12
    assert abs(whole[1]) < 0.02


def test_a_goal_after_densely_planned_frames_is_reached_smoothly(layout: Representation) -> None:
    targets = Targets(layout.skeleton)
    frames = list(range(HISTORY, HISTORY + 21))
    ways = torch.tensor([[0.1, (frame - HISTORY + 1) / 20] for frame in frames])
    targets.add_waypoints(frames, ways, torch.full((21,), 0.3))
    targets.planned, targets.faced = set(frames[:-1]), set(frames[:-1])
    root = projected(layout, targets)[:21]
    assert float(root[20, 0]) == pytest.approx(0.1, abs=1e-4)
    assert float(torch.atan2(root[20, 4], root[20, 3])) == pytest.approx(0.3, abs=1e-3)
    # If the slack of 3 cm and 0.2 rad were kept until the frame before, it would vanish in one step.
    assert float(root[10:, 0].diff().abs().max()) < 0.005
    assert float(torch.atan2(root[10:, 4], root[10:, 3]).diff().abs().max()) < 0.03


def turned_about(layout: Representation, turns: Tensor) -> Tensor:
    """Projected headings (T) of a root whose predicted ones are `turns` (T), planned to turn at 3 rad/s."""
    targets = Targets(layout.skeleton)
    frames = list(range(HISTORY, HISTORY + HORIZON))
    ways = torch.tensor([[0.0, 0.0]] * HORIZON)
    targets.add_waypoints(frames, ways, 3.0 / layout.fps * torch.arange(1, HORIZON + 1))
    targets.planned, targets.faced = set(frames), set(frames)
    root = layout.root_stats.denormalize(walk(layout))
    root[..., 3], root[..., 4] = turns.cos(), turns.sin()
    projection = made(layout, targets)
    assert projection is not None
    moved = layout.root_stats.denormalize(projection.apply(layout, layout.root_stats.normalize(root)))[0]
    return torch.from_numpy(np.unwrap(torch.atan2(moved[:, 4], moved[:, 3]).numpy()))


def test_a_root_that_is_predicted_to_flip_turns_as_planned(layout: Representation) -> None:
    late = torch.where(torch.arange(HORIZON) < 16, 0.0, 3.0 / layout.fps * torch.arange(1, HORIZON + 1) + 0.15)
    headings = turned_about(layout, late)
    planned = 3.0 / layout.fps * torch.arange(1, HORIZON + 1)
    assert float((headings - planned).abs().max()) < 0.21
    assert float(headings.diff().max()) * layout.fps < 3.0 + 1.0 + 1e-3, "a flip would be 10 rad/s"


def test_a_root_that_sways_slowly_is_left_alone(layout: Representation) -> None:
    sways = 3.0 / layout.fps * torch.arange(1, HORIZON + 1) + 0.1 * torch.sin(torch.arange(HORIZON) * 0.4)
    torch.testing.assert_close(turned_about(layout, sways).float(), sways, atol=1e-4, rtol=0)


def test_the_cache_of_goal_curves_is_bounded() -> None:
    for first in range(10):
        for second in range(first + 1, 30):
            curves = goal_curves((first, second), 40)
    assert goal_curves.cache_info().currsize * curves.nbytes < 1 << 20


@pytest.mark.parametrize(
    ("first", "count", "with_heading", "led"),
    [(0, 16, True, True), (0, 40, True, True), (0, 15, True, False), (0, 16, False, False), (1, 39, True, False)],
)
def test_a_root_given_from_the_first_frame_on_is_led(
    layout: Representation, first: int, count: int, with_heading: bool, led: bool
) -> None:
    targets = Targets(layout.skeleton)
    frames = range(HISTORY + first, HISTORY + first + count)
    targets.add_waypoints(frames, torch.zeros(count, 2), torch.zeros(count) if with_heading else None)
    projection = made(layout, targets)
    assert projection is not None
    assert projection.leads(16).tolist() == [led]
