"""The denoiser's training loss: hybrid, decoded-body, goal and consistency terms (paper, section 3.4), and kinematics.

The paper's four terms have equal weights. The kinematic ones are measured in metres on the decoded predictions, and are
what keeps planted feet planted.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.diffusion import NoiseSchedule, cosine_schedule
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.tokenizer import ExplicitBody
from motiongen_ardy.model.tokenizer.model import Tokenizer, root_from_tokens
from motiongen_ardy.model.window import Window
from motiongen_ardy.train.losses import (
    captured_kinematics,
    consistency,
    kinematic_errors,
    kinematics,
    masked_mean,
    smooth_l1,
)
from motiongen_ardy.train.windows import TrainingWindows

OWN_HISTORY_STEPS = 4  # as most windows are served


@dataclass(frozen=True)
class LossWeights:
    """The weight of each term. joints, ends: per metre; speed, planted: per metre a second."""

    hybrid: float = 1.0
    decoded: float = 1.0
    goal: float = 1.0
    consistency: float = 1.0
    joints: float = 1.0
    ends: float = 1.0
    speed: float = 0.1
    planted: float = 0.5
    history_noise: float = 0.03


def window_of(batch: TrainingWindows, patch: int) -> Window:
    """A training batch as the denoiser sees it. patch: frames per token."""
    return Window(
        history_len=batch.history_len,
        generation_len=batch.generation_len,
        num_frames=batch.features.shape[1],
        text=batch.text,
        heading=batch.heading,
        observed=batch.observed,
        mask=batch.mask,
        patch=patch,
    )


class DenoiserLoss(nn.Module):
    """A denoiser with its training loss; the codec is frozen, and its weights are not part of the training state."""

    def __init__(self, model: Model, weights: LossWeights | None = None) -> None:
        super().__init__()
        self.denoiser = model.denoiser
        self.config = model.config
        self.patch = model.config.patch
        self.root_width = model.config.denoiser.root_token_width
        self.weights = weights or LossWeights()
        self.schedule: NoiseSchedule = cosine_schedule(model.config.num_base_steps)
        self._frozen = [model.codec]  # in a list, so that it is not registered as a submodule

    @property
    def codec(self) -> Tokenizer | ExplicitBody:
        return self._frozen[0]

    def on_device(self, device: torch.device) -> NoiseSchedule:
        """The noise schedule on `device`, copied once."""
        if self.schedule.signal.device != device:
            self.schedule = self.schedule.to(device)
        return self.schedule

    def clean_tokens(self, batch: TrainingWindows) -> Tensor:
        """Hybrid tokens (B, N, 5P + L) of history and horizon, zero in the future."""
        known = batch.history_len + batch.generation_len
        valid = torch.arange(batch.num_known, device=known.device) < known[:, None]
        with torch.no_grad():
            tokens = self.codec.to_hybrid(batch.features[:, : batch.num_known], valid).float()
            tokens = tokens * valid[:, :: self.patch, None]
            ahead = (batch.features.shape[1] - batch.num_known) // self.patch
            return functional.pad(tokens, (0, 0, 0, ahead))

    def forward(self, batch: TrainingWindows) -> tuple[Tensor, dict[str, Tensor]]:
        """The total loss and its parts. If a batch has earlier windows, its history is generated from those."""
        window = window_of(batch, self.patch)
        clean = self.clean_tokens(batch)
        latents = clean[..., self.root_width :]
        if batch.earlier is not None:
            own = own_latents(self, batch.earlier.windows, min(OWN_HISTORY_STEPS, self.config.num_base_steps))
            latents = batch.earlier.as_history(own, latents)
        seen = self._seen_history(clean, latents) * window.history_tokens[..., None]
        step = torch.randint(self.config.num_base_steps, batch.history_len.shape, device=clean.device)
        noisy = self.on_device(clean.device).add_noise(clean, torch.randn_like(clean), step)
        tokens = torch.where(window.generation_tokens[..., None], noisy, seen)
        predicted = self.denoiser(tokens, step, window).float()
        with torch.autocast(clean.device.type, enabled=False):
            return self._losses(predicted, clean, batch, window)

    def _seen_history(self, clean: Tensor, latents: Tensor) -> Tensor:
        """The history as at run time, with errors: noise is added. latents: (B, N, L), those to use in it."""
        size = torch.rand(len(clean), 1, 1, device=clean.device) * 2 * self.weights.history_noise
        latents = latents + size * torch.randn_like(latents)
        return torch.cat([clean[..., : self.root_width], latents], dim=-1)

    def _losses(
        self, predicted: Tensor, clean: Tensor, batch: TrainingWindows, window: Window
    ) -> tuple[Tensor, dict[str, Tensor]]:
        layout = self.codec.representation
        known, num_tokens = batch.num_known, batch.num_known // self.patch
        horizon, target = window.generation_frames[:, :known], batch.features[:, :known]
        valid = window.history_frames[:, :known] | horizon
        # The history is the true one: the decoder is causal, and noise in the history would show in the horizon.
        tokens = torch.where(window.generation_tokens[..., None], predicted, clean)[:, :num_tokens]
        features = self._decoded(tokens, valid)
        natural, true = layout.denormalize(features), layout.denormalize(target)
        pose, true_pose = kinematics(layout, natural), captured_kinematics(layout, true)
        errors = kinematic_errors(layout, pose, true_pose, true[..., layout.contact_block], horizon)
        parts = {
            "hybrid": smooth_l1(predicted, clean, window.generation_tokens),
            "decoded": masked_mean((features - target)[..., ROOT_WIDTH:].abs(), horizon),
            "goal": self._goal(features, target, batch, horizon),
            "consistency": consistency(layout, natural, pose, horizon),
            "joints": errors.joints,
            "ends": errors.ends,
            "speed": errors.speed,
            "planted": errors.planted,
        }
        total = sum((getattr(self.weights, name) * value for name, value in parts.items()), predicted.new_zeros(()))
        return total, {name: value.detach() for name, value in parts.items()}

    def _decoded(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """Decoded features (B, PN, D) of hybrid tokens (B, N, 5P + L)."""
        root = root_from_tokens(tokens, self.patch)
        codes = self.codec.denormalize_latents(tokens[..., self.root_width :])
        body, _ = self.codec.decode_codes(codes, root, valid.sum(1), valid)
        return torch.cat([root, body.float()], dim=-1)

    @staticmethod
    def _goal(features: Tensor, target: Tensor, batch: TrainingWindows, horizon: Tensor) -> Tensor:
        """L1 over the constrained numbers of the horizon: half pooled, as in the paper, half with equal weight per row.

        With pooling alone, a row with one waypoint would count a thousandth of a row with a whole-body block.
        """
        mask = batch.mask[:, : horizon.shape[1]] * (horizon & batch.exact[:, None])[..., None]
        error = mask * (features - target).abs()
        pooled = error.sum() / mask.sum().clamp(min=1)
        counts = mask.flatten(1).sum(1)
        rows = error.flatten(1).sum(1) / counts.clamp(min=1)
        return 0.5 * pooled + 0.5 * rows.sum() / (counts > 0).sum().clamp(min=1)


def own_latents(loss: DenoiserLoss, batch: TrainingWindows, num_steps: int) -> Tensor:
    """Normalised latents (B, N, L) that the model generates for a batch's windows in `num_steps` denoising steps."""
    with torch.no_grad():
        window, clean = window_of(batch, loss.patch), loss.clean_tokens(batch)
        schedule = loss.on_device(clean.device)
        horizon = window.generation_tokens[..., None]
        known = clean * window.history_tokens[..., None]
        tokens = torch.where(horizon, torch.randn_like(clean), known)
        count = torch.full_like(batch.history_len, num_steps)
        for number in reversed(range(num_steps)):
            index = torch.full_like(batch.history_len, number)
            predicted = loss.denoiser(tokens, schedule.base_step[count, index], window).float()
            tokens = torch.where(horizon, schedule.reverse_step(tokens, predicted, index, count), known)
        return loss.codec.requantize(tokens[..., loss.root_width :])
