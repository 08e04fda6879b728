"""Prompts that a planned root contradicts: when a gait's prompt replaces them, which one, and up to which frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.model.sampling.options import PaceOptions
from motiongen_ardy.model.sampling.paces import PromptPaces, Told, told_text

FPS, FIRST, HORIZON = 20, 100, 40
STAND, WALK, RUN, UNKNOWN = torch.eye(4)
GAITS = {"stand": (0.0, 0), "walk": (0.15, 0), "run": (2.0, 0), "back": (0.15, 2), "left": (0.15, 1)}


@pytest.fixture
def paces() -> PromptPaces:
    """Three captions, known exactly, and gaits whose vectors hold their number, counted from 10."""
    return PromptPaces(
        mean=torch.zeros(4),
        directions=torch.stack([STAND, WALK, RUN]),
        speeds=torch.tensor([[0.0, 0.1], [0.8, 1.6], [2.4, 3.8]]),
        threshold=0.5,
        gaits=torch.arange(10.0, 15.0)[:, None].expand(5, 4).contiguous(),
        from_mps=torch.tensor([speed for speed, _ in GAITS.values()]),
        quarters=torch.tensor([float(quarter) for _, quarter in GAITS.values()]),
    )


def path(speeds: list[float], heading: float | None = None, every: int = 1) -> Targets:
    """A path along +Z from the origin, with a speed in m/s for each frame; given at one frame in `every`."""
    targets = Targets(load_skeleton("core27"))
    z = np.cumsum(speeds) / FPS
    rows = list(range(every - 1, len(speeds), every))
    ground = torch.tensor([[0.0, float(z[row])] for row in rows])
    headings = None if heading is None else torch.full((len(rows),), heading)
    targets.add_waypoints([FIRST + row for row in rows], ground, headings)
    return targets


def tell(paces: PromptPaces | None, text: Tensor, targets: Targets | None) -> tuple[str, int | None]:
    """The name of the gait whose prompt is used ("own" for the prompt itself), and up to which frame."""
    window = range(FIRST, FIRST + HORIZON)
    told = told_text(paces, text[None], targets, (0.0, 0.0), window, fps=FPS, options=PaceOptions())
    if torch.equal(told.text, text[None]):
        return "own", told.led_to
    return list(GAITS)[int(told.text[0, 0]) - 10], told.led_to


@pytest.mark.parametrize(
    ("prompt", "speed", "told"),
    [
        (STAND, 1.2, "walk"),
        (STAND, 3.0, "run"),
        (STAND, 0.3, "own"),  # a sway, or a step aside
        (WALK, 1.2, "own"),
        (WALK, 2.2, "own"),  # in a hurry
        (WALK, 3.5, "run"),
        (WALK, 0.6, "own"),
        (WALK, 0.1, "stand"),
        (RUN, 0.5, "walk"),
        (RUN, 1.5, "own"),
        (UNKNOWN, 3.0, "own"),
        (torch.zeros(4), 3.0, "own"),
    ],
)
def test_a_gait_replaces_a_prompt_that_the_path_contradicts(
    paces: PromptPaces, prompt: Tensor, speed: float, told: str
) -> None:
    assert tell(paces, prompt, path([speed] * HORIZON)) == (told, None)
    assert tell(paces, prompt, path([speed] * (HORIZON + 20), every=5)) == (told, None)


def test_the_prompt_is_in_force_again_once_the_root_has_arrived(paces: PromptPaces) -> None:
    assert tell(paces, STAND, path([1.2] * 20)) == ("walk", FIRST + 20)
    there, led_to = tell(paces, STAND, path([1.2] * 20 + [0.0] * 40))
    assert there == "walk"
    assert led_to is not None
    assert FIRST + 20 <= led_to <= FIRST + 25, "speeds are taken over half a second"
    assert tell(paces, WALK, path([0.0] * 30)) == ("stand", FIRST + 30)


def test_a_path_that_is_almost_over_leaves_the_prompt_in_force(paces: PromptPaces) -> None:
    assert tell(paces, STAND, path([1.2] * 7)) == ("own", None)
    assert tell(paces, STAND, path([1.2] * 8)) == ("walk", FIRST + 8)


def test_a_single_waypoint_counts_as_a_path(paces: PromptPaces) -> None:
    targets = Targets(load_skeleton("core27"))
    targets.add_waypoints([FIRST - 3, FIRST + 29], torch.tensor([[9.0, 9.0], [1.5, 0.0]]))
    assert tell(paces, STAND, targets) == ("walk", FIRST + 30)


@pytest.mark.parametrize(
    ("heading", "told"), [(None, "walk"), (0.2, "walk"), (math.pi, "back"), (-math.pi / 2, "left"), (1.6, "walk")]
)
def test_the_gait_follows_the_path_direction_relative_to_the_body(
    paces: PromptPaces, heading: float | None, told: str
) -> None:
    assert tell(paces, STAND, path([1.0] * HORIZON, heading))[0] == told


def test_without_paces_or_a_path_ahead_the_prompt_is_unchanged(paces: PromptPaces) -> None:
    fast = path([3.0] * HORIZON)
    assert tell(None, STAND, fast) == ("own", None)
    assert tell(paces, STAND, None) == ("own", None)
    assert tell(paces, STAND, Targets(load_skeleton("core27"))) == ("own", None)
    several = torch.stack([STAND, WALK])
    window = range(FIRST, FIRST + HORIZON)
    told = told_text(paces, several, fast, (0.0, 0.0), window, fps=FPS, options=PaceOptions())
    assert told == Told(several)
    passed = Targets(load_skeleton("core27"))
    passed.add_waypoints([FIRST - 1], torch.tensor([[9.0, 9.0]]))
    assert tell(paces, STAND, passed) == ("own", None)
