"""Targets -> the targets that a window is given: root goals made such that a character can get to them from here."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.paces import Told, told_text
from motiongen_ardy.model.sampling.root_plan import PlanSpan, RootGoals, plan_root, without_steering
from motiongen_ardy.model.sampling.steering import RootState

# What the root does is read from so many frames: fewer show the sway of a step, more what has long passed.
_STATE_FRAMES = 6
_TOLD_BEYOND_FRAMES = 10


def plan_targets(
    model: Model,
    targets: Targets | None,
    history: Tensor | None,
    first_frame: int,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Targets | None:
    """The targets for a window whose first new frame is first_frame; `targets` themselves where nothing is planned.

    history: (H, 5 or more) normalised features of the frames before it, in the world's frame, the root first; None or
    H = 0 where there are none and the character stands at `start`, x and z in metres, and heading in radians. Rows are
    planned one by one, and the targets that were given are not changed.
    """
    if targets is None or not model.sampling.plan_root:
        return targets
    num_history = 0 if history is None else len(history)
    end = first_frame - num_history + model.config.max_window_frames
    if not any(first_frame <= frame < end for frame in (*targets.ground, *targets.heading)):
        return targets
    told = first_frame + model.config.horizon + _TOLD_BEYOND_FRAMES
    span = PlanSpan(first_frame, told, end, model.config.fps)
    asked = without_steering(root_goals(targets), first_frame)
    planned = plan_root(asked, root_state(model.representation, history, start), span, model.sampling.plan)
    return with_root(targets, planned)


def plan_text(
    model: Model,
    text: Tensor,
    targets: Targets | None,
    history: Tensor | None,
    first_frame: int,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Told:
    """What a window is told: its prompt's text (n, W), or a gait's where its targets contradict the prompt.

    targets: as `plan_targets` gave them; history, start: as there.
    """
    if targets is None or not model.sampling.fit_prompts:
        return Told(text)
    x, z = root_state(model.representation, history, start).position
    window = range(first_frame, first_frame + model.config.horizon)
    fps, options = model.config.fps, model.sampling.paces
    return told_text(model.paces, text, targets, (x, z), window, fps=fps, options=options)


def root_goals(targets: Targets) -> RootGoals:
    """The root goals of targets as plain numbers."""
    ground, headings = list(targets.ground), list(targets.heading)
    places = torch.stack([targets.ground[frame] for frame in ground]).double().numpy() if ground else ()
    turns = torch.stack([targets.heading[frame] for frame in headings]).double().numpy() if headings else None
    angles = () if turns is None else np.arctan2(turns[:, 1], turns[:, 0]).tolist()
    return RootGoals(
        dict(zip(ground, places, strict=True)),
        dict(zip(headings, angles, strict=True)),
        set(targets.planned),
        set(targets.faced),
    )


def with_root(targets: Targets, goals: RootGoals) -> Targets:
    """A copy of targets with other root goals."""
    other = targets.copy()
    places = torch.from_numpy(np.array(list(goals.ground.values()), dtype=np.float32).reshape(-1, 2))
    angles = torch.from_numpy(np.array(list(goals.heading.values()), dtype=np.float32))
    other.ground = dict(zip(goals.ground, places.unbind(), strict=True))
    other.heading = dict(zip(goals.heading, torch.stack([angles.cos(), angles.sin()], dim=-1).unbind(), strict=True))
    other.planned, other.faced = set(goals.planned), set(goals.faced)
    return other


def root_state(layout: Representation, history: Tensor | None, start: tuple[float, float, float]) -> RootState:
    """What the root does at the end of a history (H, 5 or more, normalised); at `start` it stands."""
    if history is None or not len(history):
        return RootState(np.array(start[:2], dtype=np.float64), np.zeros(2), float(start[2]))
    root = layout.root_stats.denormalize(history[-_STATE_FRAMES:, :ROOT_WIDTH]).double().cpu().numpy()
    ground, last = root[:, [0, 2]], root[-1]
    velocity = (ground[-1] - ground[0]) * (layout.fps / max(1, len(ground) - 1))
    return RootState(ground[-1], velocity, float(np.arctan2(last[4], last[3])))
