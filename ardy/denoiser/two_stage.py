"""The two-stage denoiser: predict the clean root, then the clean latents given that root.

Attribute names are those of the released checkpoints.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ardy.config import FRAMES_PER_TOKEN, DenoiserConfig
from ardy.denoiser.blocks import StageTransformer
from ardy.representation import LOCAL_ROOT_WIDTH, ROOT_WIDTH, Representation
from ardy.tokenizer.model import ROOT_TOKEN_WIDTH, root_from_tokens
from ardy.window import Window

LOCAL_ROOT_TOKEN_WIDTH = LOCAL_ROOT_WIDTH * FRAMES_PER_TOKEN


class Goals(NamedTuple):
    """A window's constraints by token: observed root and body and the whole mask, frame-major, (B, N, ...)."""

    observed_root: Tensor
    root_mask: Tensor
    observed_body: Tensor
    mask: Tensor


def by_token(frames: Tensor) -> Tensor:
    """(B, 4N, C) -> (B, N, 4C), frame-major."""
    return frames.unflatten(1, (-1, FRAMES_PER_TOKEN)).flatten(-2)


def where_tokens(kind: Tensor, chosen: Tensor, otherwise: Tensor) -> Tensor:
    """chosen where kind (B, N) is true, else otherwise; both (B, N, C), cast to one type under autocast."""
    return torch.where(kind[..., None], chosen, otherwise.to(chosen.dtype))


def leading_columns(projection: nn.Linear, values: Tensor) -> Tensor:
    """The projection of values (B, N, C) whose further inputs, the goals, are all zero."""
    return nn.functional.linear(values, projection.weight[:, : values.shape[-1]], projection.bias)


class Denoiser(nn.Module):
    """What both denoisers share: the projections of tokens and goals, and how a window's goals are laid out."""

    def __init__(self, config: DenoiserConfig, representation: Representation) -> None:
        super().__init__()
        self.config = config
        self.representation = representation
        width, features = config.transformer.width, representation.feature_dim
        goal_width = FRAMES_PER_TOKEN * (features + representation.body_dim)
        hybrid_width = ROOT_TOKEN_WIDTH + config.latent_dim
        self.global_root_hybrid_proj = nn.Linear(hybrid_width, width)
        self.global_root_hybrid_constraints_proj: nn.Linear | None = None
        self.future_constraints_proj: nn.Linear | None = None
        if config.constraints:
            self.global_root_hybrid_constraints_proj = nn.Linear(hybrid_width + goal_width, width)
            self.future_constraints_proj = nn.Linear(2 * FRAMES_PER_TOKEN * features, width)

    def forward(self, tokens: Tensor, step: Tensor, window: Window) -> Tensor:
        """Predict clean tokens.

        tokens: (B, N, 20 + L): history (clean), then horizon (noisy), zero elsewhere. step: (B) int64 base diffusion
        index. Returns (B, N, 20 + L): history as given, horizon predicted, zero elsewhere.
        """
        raise NotImplementedError("a subclass defines the stages")

    def goals(self, window: Window) -> Goals | None:
        """The window's constraints by token, None when it has none or the model takes none."""
        if not self.config.constraints or window.mask is None or window.observed is None:
            return None
        return Goals(
            observed_root=by_token(window.observed[..., :ROOT_WIDTH]),
            root_mask=by_token(window.mask[..., :ROOT_WIDTH]),
            observed_body=by_token(window.observed[..., ROOT_WIDTH:]),
            mask=by_token(window.mask),
        )

    def hybrid_inputs(self, tokens: Tensor, goals: Goals | None, window: Window) -> tuple[Tensor, Tensor]:
        """Input vectors (B, N, width) of a stage that reads the global root, and those of the future tokens alone.

        In horizon tokens the root is overwritten where it is constrained.
        """
        history, horizon = window.history_tokens, window.generation_tokens
        plain = self.global_root_hybrid_proj(tokens)
        if self.global_root_hybrid_constraints_proj is None or self.future_constraints_proj is None:
            return where_tokens(history | horizon, plain, torch.zeros_like(plain)), torch.zeros_like(plain)
        root, latent = tokens[..., :ROOT_TOKEN_WIDTH], tokens[..., ROOT_TOKEN_WIDTH:]
        if goals is None:
            noisy = leading_columns(self.global_root_hybrid_constraints_proj, torch.cat([latent, root], dim=-1))
            ahead = torch.zeros_like(noisy)
            return where_tokens(horizon, noisy, where_tokens(history, plain, ahead)), ahead
        overwritten = root * (1 - goals.root_mask) + goals.observed_root * goals.root_mask
        known = torch.cat([overwritten, goals.observed_body, goals.mask], dim=-1)
        noisy = self.global_root_hybrid_constraints_proj(torch.cat([latent, known], dim=-1))
        future = window.future_tokens
        if bool(future.any()):
            ahead = where_tokens(future, self.future_constraints_proj(known), torch.zeros_like(noisy))
        else:
            ahead = torch.zeros_like(noisy)
        return where_tokens(horizon, noisy, where_tokens(history, plain, ahead)), ahead

    @staticmethod
    def fuse(prediction: Tensor, given: Tensor, window: Window) -> Tensor:
        """Horizon tokens from the prediction, history tokens as given, zero elsewhere; all (B, N, C)."""
        kept = given * window.history_tokens[..., None]
        return torch.where(window.generation_tokens[..., None], prediction.to(given.dtype), kept)

    @staticmethod
    def visible(window: Window) -> Tensor:
        """(B, N) bool: the motion tokens that attention may look at."""
        return window.history_tokens | window.generation_tokens | window.future_tokens


class TwoStageDenoiser(Denoiser):
    """Root stage, then body stage on the local root of the first stage's prediction."""

    def __init__(self, config: DenoiserConfig, representation: Representation) -> None:
        super().__init__(config, representation)
        width = config.transformer.width
        goal_width = FRAMES_PER_TOKEN * (representation.feature_dim + representation.body_dim)
        local_width = LOCAL_ROOT_TOKEN_WIDTH + config.latent_dim
        self.root_model = StageTransformer(config, ROOT_TOKEN_WIDTH)
        self.body_model = StageTransformer(config, config.latent_dim)
        self.local_root_hybrid_proj = nn.Linear(local_width, width)
        self.local_root_hybrid_constraints_proj: nn.Linear | None = None
        if config.constraints:
            self.local_root_hybrid_constraints_proj = nn.Linear(local_width + goal_width, width)

    def forward(self, tokens: Tensor, step: Tensor, window: Window) -> Tensor:
        goals = self.goals(window)
        visible = self.visible(window)
        inputs, ahead = self.hybrid_inputs(tokens, goals, window)
        root = self.root_model(inputs, visible, window, step)
        root = self.fuse(root, tokens[..., :ROOT_TOKEN_WIDTH], window)
        # The body stage learns from the predicted root but does not train it (paper, section 3.4).
        inputs = self.local_inputs(tokens, root.detach(), goals, ahead, window)
        latent = self.body_model(inputs, visible, window, step)
        latent = self.fuse(latent, tokens[..., ROOT_TOKEN_WIDTH:], window)
        return torch.cat([root, latent], dim=-1)

    def local_inputs(self, tokens: Tensor, root: Tensor, goals: Goals | None, ahead: Tensor, window: Window) -> Tensor:
        """Input vectors (B, N, width) of the body stage; root: the first stage's result (B, N, 20)."""
        lengths = window.history_len + window.generation_len
        local = by_token(self.representation.local_root(root_from_tokens(root), lengths))
        latent = tokens[..., ROOT_TOKEN_WIDTH:]
        known = torch.cat([local, latent], dim=-1)
        plain = self.local_root_hybrid_proj(known)
        if self.local_root_hybrid_constraints_proj is None:
            keep = window.history_tokens | window.generation_tokens
            return where_tokens(keep, plain, torch.zeros_like(plain))
        if goals is None:
            noisy = leading_columns(self.local_root_hybrid_constraints_proj, known)
        else:
            noisy = self.local_root_hybrid_constraints_proj(
                torch.cat([known, goals.observed_body, goals.mask], dim=-1)
            )
        return where_tokens(window.generation_tokens, noisy, where_tokens(window.history_tokens, plain, ahead))


class OneStageDenoiser(Denoiser):
    """The paper's ablation: one transformer predicts root and latents at once."""

    def __init__(self, config: DenoiserConfig, representation: Representation) -> None:
        super().__init__(config, representation)
        self.root_model = StageTransformer(config, ROOT_TOKEN_WIDTH + config.latent_dim)

    def forward(self, tokens: Tensor, step: Tensor, window: Window) -> Tensor:
        inputs, _ = self.hybrid_inputs(tokens, self.goals(window), window)
        return self.fuse(self.root_model(inputs, self.visible(window), window, step), tokens, window)


def build_denoiser(config: DenoiserConfig, representation: Representation) -> Denoiser:
    """A denoiser with fresh weights: two stages, or one for the ablation."""
    return (TwoStageDenoiser if config.num_stages == 2 else OneStageDenoiser)(config, representation)


