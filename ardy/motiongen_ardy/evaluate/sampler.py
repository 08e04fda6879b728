"""Many takes at once: every window that is due, batched with those of equal shape, as the server makes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.capabilities import LocomotionPreset
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.skeleton import positions_from_global
from motiongen_ardy.evaluate.gait import gait_of
from motiongen_ardy.evaluate.steering import SLOWING_FRAMES, STATE_FRAMES, add_lead, lead_by
from motiongen_ardy.evaluate.take import Result, Steer, Take
from motiongen_ardy.model.config import FRAMES_PER_TOKEN
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights, batch_passes, needed_passes
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.noise import window_noise
from motiongen_ardy.model.rollout import (
    DEFAULT_HISTORY_FRAMES,
    WindowRequest,
    commit_window,
    denoise_step,
    finish_window,
    start_window,
    visible_frames,
    weights_of,
)
from motiongen_ardy.model.sampling.plan import plan_targets, plan_text
from motiongen_ardy.model.tokenizer.model import ROOT_TOKEN_WIDTH
from motiongen_ardy.text import TextEncoder


@dataclass(frozen=True)
class Sampling:
    """How windows are made: steps, guidance (the model's own if None), and how many rows go through at once."""

    num_steps: int
    weights: GuidanceWeights | None = None
    batch: int = 32


@dataclass
class _Growing:
    """A take under way. features: (T, D) normalised; gait: of the velocity in force."""

    take: Take
    features: Tensor
    gait: LocomotionPreset | None = None
    starts: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class _Due:
    """The next window of a take. crop: frames of history; span: frames that it sees; text: (1, W), zeros for none;
    end: the frame at which it is told something else.
    """

    growing: _Growing
    crop: int
    span: int
    targets: Targets | None
    text: Tensor
    end: int

    @property
    def shape(self) -> tuple[int, int, bool, bool]:
        return self.crop, self.span, self.targets is not None, bool(self.text.any())

    @property
    def first(self) -> int:
        return len(self.growing.features)


class Sampler:
    """Runs takes on one model. `num_windows` counts what it has made."""

    def __init__(
        self, model: Model, encoder: TextEncoder, sampling: Sampling, gaits: Sequence[LocomotionPreset] = ()
    ) -> None:
        """gaits: the model's prompts by speed, which hold while a velocity does."""
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
        """All takes, in their order."""
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
        take = growing.take
        first = len(growing.features)
        crop = min(DEFAULT_HISTORY_FRAMES, first // FRAMES_PER_TOKEN * FRAMES_PER_TOKEN)
        targets = take.targets
        steer = take.steer_at(first)
        growing.gait = None if steer is None else gait_of(self.gaits, steer, growing.gait)
        prompt = take.prompt_at(first) if growing.gait is None else growing.gait.text
        text, end = self.text(prompt), min(first + self.model.config.horizon, take.next_change(first), take.num_frames)
        leader = take.steer_at(first, after=SLOWING_FRAMES)
        if leader is not None:
            targets = self._led(growing, leader, targets)
        seen_to = first - crop + self.model.config.max_window_frames
        if targets is not None and not any(first <= frame < seen_to for frame in targets.frames):
            targets = None
        history = growing.features[first - crop :]
        targets = plan_targets(self.model, targets, history, first, take.start)
        if leader is None:
            text, led_to = plan_text(self.model, text, targets, history, first, take.start)
            end = end if led_to is None else min(end, led_to)
        span = visible_frames(self.model, crop, targets, first - crop)
        return _Due(growing, crop, span, targets, text, end)

    def _led(self, growing: _Growing, steer: Steer, given: Targets | None) -> Targets | None:
        """The targets of the next window with what a velocity leads through beneath them."""
        layout, take, options = self.model.representation, growing.take, self.model.sampling
        first = len(growing.features)
        last = layout.denormalize(growing.features[-STATE_FRAMES:])
        root = last[:, [0, 2]].numpy() if first else np.array([take.start[:2]])
        heading = float(torch.atan2(last[-1, 4], last[-1, 3])) if first else take.start[2]
        lead = lead_by(steer, first, self.model.config.horizon, root, heading, layout.fps)
        if lead is None:
            return given
        targets = Targets(layout.skeleton) if given is None else given.copy()
        add_lead(targets, lead, first, options.plan.stride_frames if options.plan_root else 1)
        return targets

    def _windows(self, group: list[_Due]) -> None:
        """One window of each, appended to its take."""
        model, layout = self.model, self.model.representation
        crop, span, has_targets, has_text = group[0].shape
        num_tokens = model.config.horizon // FRAMES_PER_TOKEN
        width = ROOT_TOKEN_WIDTH + model.config.denoiser.latent_dim
        observed = mask = planned = None
        if has_targets:
            told = [(due.targets, due.first - crop) for due in group if due.targets is not None]
            pairs = [targets.observe(layout, first, span) for targets, first in told]
            observed, mask = (torch.stack(part) for part in zip(*pairs, strict=True))
            planned = torch.stack([targets.planned_frames(first, span) for targets, first in told])
        takes = [due.growing.take for due in group]
        request = WindowRequest(
            num_frames=span,
            num_steps=self.sampling.num_steps,
            text=torch.stack([due.text for due in group]),
            noise=torch.stack(
                [window_noise(due.growing.take.seed, len(due.growing.starts), num_tokens, width) for due in group]
            ),
            weights=self.sampling.weights,
            history=torch.stack([due.growing.features[due.first - crop :] for due in group]) if crop else None,
            translation=torch.tensor([[take.start[0], 0.0, take.start[1]] for take in takes]),
            heading=torch.tensor([take.start[2] for take in takes]),
            observed=observed,
            mask=mask,
            planned=planned,
        )
        state = start_window(model, request)
        # The same weighted sum in as few evaluations as give it, as the server does.
        weights = weights_of(model, self.sampling.weights)
        passes = needed_passes(model.sampling.guidance.mode, weights, has_text, has_targets)
        state = replace(state, passes=batch_passes([passes] * len(group)))
        for index in reversed(range(self.sampling.num_steps)):
            state = denoise_step(model, state, index, self.sampling.num_steps)
        new = commit_window(model, request, finish_window(model, state))
        self.num_windows += len(group)
        for due, frames in zip(group, new, strict=True):
            due.growing.starts.append(due.first)
            due.growing.features = torch.cat([due.growing.features, frames[: due.end - due.first]])

    def _result(self, growing: _Growing) -> Result:
        layout = self.model.representation
        return result_of(layout, growing.take, layout.denormalize(growing.features), tuple(growing.starts))


def result_of(layout: Representation, take: Take, features: Tensor, starts: tuple[int, ...] = ()) -> Result:
    """The result of features (T, D) in natural units, its positions by kinematics of their rotations."""
    rotations = layout.global_rotations(features)
    positions = positions_from_global(layout.skeleton, rotations, features[:, layout.root_position_block])
    return Result(take, features, positions, rotations, starts)
