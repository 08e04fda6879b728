"""Plans the targets of a window: turns root goals into ones that a character can reach from where it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch import Tensor

from motiongen_ardy.core.constraint import Targets, facings
from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.paces import Told, told_text
from motiongen_ardy.model.sampling.root_plan import PlanSpan, RootGoals, plan_root, without_steering
from motiongen_ardy.model.sampling.steering import RootState

# Frames from which the root's velocity is measured: fewer show the sway of a step, more what has long passed.
_STATE_FRAMES = 6
_TOLD_BEYOND_FRAMES = 10


class WindowPlan(NamedTuple):
    """The targets and the text that a window is given."""

    targets: Targets | None
    told: Told


def plan_window(
    model: Model,
    targets: Targets | None,
    text: Tensor,
    history: Tensor | None,
    first_frame: int,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    keep_text: bool = False,
) -> WindowPlan:
    """The targets and the text (n, W) for the window whose first new frame is first_frame.

    The targets are those that lead to what is asked for, or `targets` itself if nothing is planned. The text is that
    given, or a gait's where the targets contradict it, unless keep_text. history: (H, 5 or more), normalised features
    of the frames before the window in the world frame, root first; if it is None or empty, the character stands at
    `start` (x and z in metres, heading in radians). Rows are planned one by one; arguments are not changed.
    """
    sampling = model.sampling
    if targets is None or not (sampling.plan_root or sampling.fit_prompts):
        return WindowPlan(targets, Told(text))
    state = root_state(model.representation, history, start)
    if sampling.plan_root:
        targets = _planned(model, targets, state, first_frame, 0 if history is None else len(history))
    if keep_text or not sampling.fit_prompts:
        return WindowPlan(targets, Told(text))
    x, z = state.position
    window = range(first_frame, first_frame + model.config.horizon)
    told = told_text(model.paces, text, targets, (x, z), window, fps=model.config.fps, options=sampling.paces)
    return WindowPlan(targets, told)


def _planned(model: Model, targets: Targets, state: RootState, first_frame: int, num_history: int) -> Targets:
    """Targets that lead from the root's state to what is asked for."""
    end = first_frame - num_history + model.config.max_window_frames
    if not any(first_frame <= frame < end for frame in (*targets.ground, *targets.heading)):
        return targets
    told = first_frame + model.config.horizon + _TOLD_BEYOND_FRAMES
    span = PlanSpan(first_frame, told, end, model.config.fps)
    asked = without_steering(root_goals(targets), first_frame, {frame for frame, joint in targets.positions if joint})
    return with_root(targets, plan_root(asked, state, span, model.sampling.plan))


def root_goals(targets: Targets) -> RootGoals:
    """The root goals of targets, in double precision."""
    places = np.array(list(targets.ground.values()), np.float64)
    turns = np.array(list(targets.heading.values()), np.float64).reshape(-1, 2)
    return RootGoals(
        dict(zip(targets.ground, places, strict=True)),
        dict(zip(targets.heading, np.arctan2(turns[:, 1], turns[:, 0]).tolist(), strict=True)),
        set(targets.planned),
        set(targets.faced),
    )


def with_root(targets: Targets, goals: RootGoals) -> Targets:
    """A copy of targets with their root goals replaced."""
    other = targets.copy()
    places = np.array(list(goals.ground.values()), np.float32)
    other.ground = dict(zip(goals.ground, places, strict=True))
    other.heading = dict(zip(goals.heading, facings(np.array(list(goals.heading.values()), np.float32)), strict=True))
    other.planned, other.faced = set(goals.planned), set(goals.faced)
    return other


def root_state(layout: Representation, history: Tensor | None, start: tuple[float, float, float]) -> RootState:
    """The root's state at the end of a history (H, 5 or more, normalised), on any device; else standing at `start`."""
    if history is None or not len(history):
        return RootState(np.array(start[:2], dtype=np.float64), np.zeros(2), float(start[2]))
    recent = history[-_STATE_FRAMES:, :ROOT_WIDTH].cpu()  # copied at once: each row would synchronise with the GPU
    root = layout.root_stats.on_host.denormalize(recent).double().numpy()
    ground, last = root[:, [0, 2]], root[-1]
    velocity = (ground[-1] - ground[0]) * (layout.fps / max(1, len(ground) - 1))
    return RootState(ground[-1], velocity, float(np.arctan2(last[4], last[3])))
