"""Slowing: a root that would stop at once loses its speed over half a second; other roots are left alone."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.sampling.options import ProjectionOptions, SamplingOptions
from motiongen_ardy.model.sampling.projection import free_projection, make_projection
from motiongen_ardy.model.sampling.slowing import FREE_M_S, motion_before
from motiongen_ardy.model.tokenizer.model import by_token

TINY = Path(__file__).parents[3] / "data" / "golden" / "tiny-core27" / "checkpoint"
PATCH, HISTORY, HORIZON, FPS = 4, 16, 40, 20
OPTIONS = SamplingOptions(project_root=True)
SPEED = 1.2


@pytest.fixture(scope="module")
def layout() -> Representation:
    return load_checkpoint(TINY).representation


def root(layout: Representation, along: Tensor) -> Tensor:
    """A normalised root (1, T, 5) at places `along` metres ahead."""
    frames = torch.zeros(1, len(along), ROOT_WIDTH)
    frames[..., 1], frames[..., 2], frames[..., 3] = 0.9, along, 1.0
    return layout.root_stats.normalize(frames)


def before(layout: Representation, speed: float = SPEED) -> Tensor:
    """`motion_before` of a history that walks ahead and ends at the origin."""
    tokens = by_token(root(layout, torch.arange(1 - HISTORY, 1) * speed / FPS), PATCH)
    return motion_before(layout, torch.cat([tokens, torch.zeros(1, HISTORY // PATCH, 64)], dim=-1), PATCH)


def speeds(layout: Representation, along: Tensor, history_speed: float = SPEED) -> Tensor:
    """Forward speeds in m/s of a root that goes `along` after such a history, once it is projected."""
    projection = free_projection(before(layout, history_speed), HISTORY, HORIZON, OPTIONS)
    given = root(layout, along)
    made = given if projection is None else projection.apply(layout, given)
    ahead = layout.root_stats.denormalize(made)[0, :, 2]
    return torch.cat([ahead[:1], ahead.diff()]) * FPS


def test_motion_at_the_end_of_a_history_is_read_from_its_tokens(layout: Representation) -> None:
    assert before(layout)[0].tolist() == pytest.approx([0.0, 0.0, 0.0, SPEED], abs=1e-3)
    assert motion_before(layout, torch.zeros(2, 0, ROOT_WIDTH * PATCH + 64), PATCH).tolist() == [[0.0] * 4] * 2


def test_a_root_that_would_stop_at_once_slows_down_gradually(layout: Representation) -> None:
    made = speeds(layout, torch.zeros(HORIZON))
    slowing = torch.cat([torch.tensor([SPEED]), made]).diff() * FPS
    assert float(made[0]) > 0.6
    assert float(slowing[1:].min()) > -4.0
    assert made.diff().max() < 1e-4
    assert float(made[13:].abs().max()) < 1e-3


def test_a_root_that_slows_down_by_itself_is_left_alone(layout: Representation) -> None:
    own = (SPEED * (1 - torch.arange(1, HORIZON + 1) / 20).clamp(min=0)).cumsum(dim=0) / FPS
    assert torch.allclose(speeds(layout, own).cumsum(dim=0) / FPS, own, atol=1e-5)


@pytest.mark.parametrize("speed", [0.0, FREE_M_S])
def test_a_root_that_hardly_moved_needs_no_slowing(layout: Representation, speed: float) -> None:
    assert free_projection(before(layout, speed), HISTORY, HORIZON, OPTIONS) is None


def test_a_row_that_hardly_moved_is_unchanged_beside_one_that_walks(layout: Representation) -> None:
    both = torch.cat([before(layout, 0.9 * FREE_M_S), before(layout)])
    projection = free_projection(both, HISTORY, HORIZON, OPTIONS)
    assert projection is not None
    back = root(layout, -torch.arange(1, HORIZON + 1) * FREE_M_S / FPS).repeat(2, 1, 1)
    made = projection.apply(layout, back)
    assert torch.equal(made[0], back[0])
    assert not torch.equal(made[1], back[1])


def test_a_root_that_speeds_up_is_not_slowed(layout: Representation) -> None:
    run = torch.arange(1, HORIZON + 1) * 3.0 / FPS
    assert torch.allclose(speeds(layout, run), torch.full((HORIZON,), 3.0), atol=1e-3)


def test_a_root_with_a_waypoint_ahead_is_not_slowed(layout: Representation) -> None:
    targets = Targets(layout.skeleton)
    targets.add_waypoints([HISTORY + 30], torch.zeros(1, 2))
    observed, mask = (part[None] for part in targets.observe(layout, 0, HISTORY + HORIZON))
    projection = make_projection(
        layout, observed, mask, None, first=HISTORY, num_frames=HORIZON, options=OPTIONS, before=before(layout)
    )
    assert projection is not None
    given = root(layout, torch.zeros(HORIZON))
    assert torch.allclose(projection.apply(layout, given), given, atol=1e-6)


def test_without_the_options_for_slowing_there_is_no_projection(layout: Representation) -> None:
    moving = before(layout)
    at_once = SamplingOptions(project_root=True, projection=ProjectionOptions(slowing_s=0.0))
    assert free_projection(moving, HISTORY, HORIZON, SamplingOptions()) is None
    assert free_projection(moving, HISTORY, HORIZON, at_once) is None
