"""Generates many takes at once: all windows that are due, batched by equal shape, as the server makes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.capabilities import LocomotionPreset
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.skeleton import positions_from_global
from motiongen_ardy.evaluate.take import Result, Steer, Take
from motiongen_ardy.locomotion.gait import gait_of
from motiongen_ardy.locomotion.velocity import SLOWING_FRAMES, STATE_FRAMES, lead_by, root_state
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights, batch_passes, needed_passes
from motiongen_ardy.model.generation import (
    WindowRequest,
    commit_window,
    denoise_window,
    finish_window,
    stack_windows,
    weights_of,
)
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.rollout import RolloutRequest, next_window, usual_history
from motiongen_ardy.text import TextEncoder


class MotionNotFinite(ValueError):
    """Raised for a model whose motion contains NaN or infinite numbers, from which no figures can be made."""


@dataclass(frozen=True)
class Sampling:
    """How windows are made: steps, guidance (None: the model's own), and the most rows of a batch."""

    num_steps: int
    weights: GuidanceWeights | None = None
    batch: int = 32


@dataclass
class _Growing:
    """A take that is being generated. features: (T, D), normalised; gait: of the velocity in force."""

    take: Take
    features: Tensor
    gait: LocomotionPreset | None = None
    starts: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class _Due:
    """The next window of a take, a batch of one. end: up to where it is kept. has_text: whether it has a prompt."""

    growing: _Growing
    window: WindowRequest
    end: int
    has_text: bool

    @property
    def shape(self) -> tuple[int, int, bool, bool]:
        """What windows must have in common to be batched."""
        return self.window.history_frames, self.window.num_frames, self.window.mask is not None, self.has_text


class Sampler:
    """Generates takes with one model. `num_windows` counts the windows made."""

    def __init__(
        self, model: Model, encoder: TextEncoder, sampling: Sampling, gaits: Sequence[LocomotionPreset] = ()
    ) -> None:
        """gaits: the model's prompts by speed, used while a velocity is in force."""
        self.model = model
        self.gaits = gaits
        self.sampling = sampling
        self.num_windows = 0
        self._encoder = encoder
        self._texts: dict[str, Tensor] = {}

    def text(self, prompt: str) -> Tensor:
        """The prompt's embedding (1, W); zeros for none."""
        if prompt not in self._texts:
            self._texts[prompt] = torch.from_numpy(self._encoder.encode([prompt]))
        return self._texts[prompt]

    @torch.inference_mode()
    def run(self, takes: Sequence[Take]) -> list[Result]:
        """The results of all takes, in order. Raises MotionNotFinite."""
        layout = self.model.representation
        none = torch.zeros(0, layout.feature_dim)
        growing = [
            _Growing(take, none if take.history is None else layout.normalize(take.history).float()) for take in takes
        ]
        while due := [self._due(one) for one in growing if len(one.features) < one.take.num_frames]:
            groups: dict[tuple[int, int, bool, bool], list[_Due]] = {}
            for one in due:
                groups.setdefault(one.shape, []).append(one)
            for group in groups.values():
                for first in range(0, len(group), self.sampling.batch):
                    self._windows(group[first : first + self.sampling.batch])
        return [self._result(one) for one in growing]

    def _due(self, growing: _Growing) -> _Due:
        """The next window, as of a rollout with what is in force now; constraints beyond its reach do not count."""
        take, first = growing.take, len(growing.features)
        steer = take.steer_at(first)
        if steer is None or steer.keep_prompt:
            growing.gait = None
        else:
            growing.gait = gait_of(self.gaits, steer.x, steer.z, steer.heading, growing.gait)
        prompt = take.prompt_at(first) if growing.gait is None else growing.gait.text
        leader = take.steer_at(first, after=SLOWING_FRAMES)
        targets = take.targets if leader is None else self._led(growing, leader, take.targets)
        patch = self.model.config.patch
        crop = min(usual_history(patch), first // patch * patch)
        seen_to = first - crop + self.model.config.max_window_frames
        if targets is not None and not any(first <= frame < seen_to for frame in targets.frames):
            targets = None
        now = RolloutRequest(
            num_frames=take.num_frames,
            text=self.text(prompt),
            seed=take.seed,
            num_steps=self.sampling.num_steps,
            weights=self.sampling.weights,
            targets=targets,
            start=take.start,
            keep_prompts=leader is not None,  # the velocity has already chosen its prompt
        )
        window, end = next_window(self.model, now, growing.features, len(growing.starts))
        return _Due(growing, window, min(end, take.next_change(first)), bool(prompt))

    def _led(self, growing: _Growing, steer: Steer, given: Targets | None) -> Targets | None:
        """The targets of the next window: those of the velocity, overridden by the given ones."""
        layout, take, options = self.model.representation, growing.take, self.model.sampling
        first = len(growing.features)
        last = layout.denormalize(growing.features[-STATE_FRAMES:])
        ground = last[:, [0, 2]].numpy() if first else np.array([take.start[:2]])
        heading = float(torch.atan2(last[-1, 4], last[-1, 3])) if first else take.start[2]
        held = steer.frame + steer.hold_frames - first
        root = root_state(ground, heading, layout.fps)
        lead = lead_by((steer.x, steer.z), steer.heading, held, self.model.config.horizon, root, layout.fps)
        if lead is None:
            return given
        targets = Targets(layout.skeleton)
        facing = None if lead.heading is None else torch.from_numpy(lead.heading).float()
        stride = options.plan.stride_frames if options.plan_root else 1
        targets.add_lead(first, torch.from_numpy(lead.ground).float(), facing, stride)
        if given is not None:
            targets.add_all(given)
        return targets

    def _windows(self, group: list[_Due]) -> None:
        """Generate one window for each, and append it to its take."""
        model = self.model
        _, _, has_targets, has_text = group[0].shape
        # The same weighted sum with as few evaluations as possible, as the server does.
        weights = weights_of(model, self.sampling.weights)
        passes = needed_passes(model.sampling.guidance.mode, weights, has_text, has_targets)
        window = stack_windows([due.window for due in group])
        state = denoise_window(model, window, batch_passes([passes] * len(group)))
        new = commit_window(model, window, finish_window(model, state))
        self.num_windows += len(group)
        for due, frames in zip(group, new, strict=True):
            growing, first = due.growing, len(due.growing.features)
            growing.starts.append(first)
            growing.features = torch.cat([growing.features, frames[: due.end - first]])

    def _result(self, growing: _Growing) -> Result:
        layout, take = self.model.representation, growing.take
        if not bool(growing.features.isfinite().all()):
            # Figures leave out NaN, so a model that produces nothing else would miss no bound.
            frame = int((~growing.features.isfinite().all(dim=1)).nonzero()[0])
            raise MotionNotFinite(f"the model's motion is not finite from frame {frame} on, in {take.case!r}")
        return result_of(layout, take, layout.denormalize(growing.features), tuple(growing.starts))


def result_of(layout: Representation, take: Take, features: Tensor, starts: tuple[int, ...] = ()) -> Result:
    """The result of features (T, D) in natural units, with positions from their rotations by kinematics."""
    rotations = layout.global_rotations(features)
    positions = positions_from_global(layout.skeleton, rotations, features[:, layout.root_position_block])
    return Result(take, features, positions, rotations, starts)
