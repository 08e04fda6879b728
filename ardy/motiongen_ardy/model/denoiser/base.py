"""What both denoisers share: how tokens, constraints and future become the input vectors of a stage.

Attribute names are those of the released checkpoints.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.config import DenoiserConfig
from motiongen_ardy.model.denoiser.goals import Goals, goals_of
from motiongen_ardy.model.precision import InWeightPrecision
from motiongen_ardy.model.tokenizer.model import by_token, root_from_tokens
from motiongen_ardy.model.window import Window


def where_tokens(kind: Tensor, chosen: Tensor, otherwise: Tensor) -> Tensor:
    """`chosen` where kind (B, N) is true, else `otherwise`; both (B, N, C), cast to one type under autocast."""
    return torch.where(kind[..., None], chosen, otherwise.to(chosen.dtype))


def leading_columns(projection: nn.Linear, values: Tensor) -> Tensor:
    """The projection of values (B, N, C), with zeros for its remaining inputs, the goals."""
    return functional.linear(values, projection.weight[:, : values.shape[-1]], projection.bias)


class Denoiser(InWeightPrecision, ABC):
    """Predicts clean hybrid tokens from noisy ones."""

    def __init__(self, config: DenoiserConfig, representation: Representation) -> None:
        super().__init__()
        self.config = config
        self.representation = representation
        width, features = config.transformer.width, representation.feature_dim
        self.root_width = config.root_token_width
        self.goal_width = config.patch * (features + representation.body_dim)
        hybrid_width = self.root_width + config.latent_dim
        self.global_root_hybrid_proj = nn.Linear(hybrid_width, width)
        self.global_root_hybrid_constraints_proj: nn.Linear | None = None
        self.future_constraints_proj: nn.Linear | None = None
        if config.constraints:
            self.global_root_hybrid_constraints_proj = nn.Linear(hybrid_width + self.goal_width, width)
            self.future_constraints_proj = nn.Linear(2 * config.patch * features, width)

    @abstractmethod
    def forward(self, tokens: Tensor, step: Tensor, window: Window) -> Tensor:
        """Predict clean tokens.

        tokens: (B, N, 5P + L): history (clean), then horizon (noisy), zero elsewhere. step: (B) int64, base diffusion
        step. Returns (B, N, 5P + L): history as given, horizon predicted, zero elsewhere.
        """

    def goals(self, window: Window) -> Goals | None:
        """The window's constraints per token; None if it has none or the model takes none."""
        return goals_of(window) if self.config.constraints else None

    def hybrid_inputs(self, tokens: Tensor, goals: Goals | None, window: Window) -> tuple[Tensor, Tensor]:
        """Input vectors (B, N, width) of a stage that reads the global root, and separately those of the future tokens.

        In horizon tokens, the root is overwritten where it is constrained.
        """
        plain = self.global_root_hybrid_proj(tokens)
        root, latent = tokens[..., : self.root_width], tokens[..., self.root_width :]
        noisy, ahead = plain, torch.zeros_like(plain)
        if self.global_root_hybrid_constraints_proj is not None and goals is None:
            noisy = leading_columns(self.global_root_hybrid_constraints_proj, torch.cat([latent, root], dim=-1))
        elif self.global_root_hybrid_constraints_proj is not None and goals is not None:
            known = torch.cat([goals.overwrite(root), goals.observed_body, goals.mask], dim=-1)
            noisy = self.global_root_hybrid_constraints_proj(torch.cat([latent, known], dim=-1))
            ahead = self.future_inputs(known, window)
        return self.join(noisy, plain, ahead, window), ahead

    def future_inputs(self, known: Tensor, window: Window) -> Tensor:
        """Vectors (B, N, width) of the visible future tokens, zero elsewhere. known: (B, N, 2PD), root, goals, mask."""
        future = window.future_tokens
        # In training, every weight must take part in every batch: distributed training relies on it.
        if self.future_constraints_proj is None or not (self.training or bool(future.any())):
            return known.new_zeros(*future.shape, self.config.transformer.width)
        vectors = self.future_constraints_proj(known)
        return where_tokens(future, vectors, torch.zeros_like(vectors))

    @staticmethod
    def join(noisy: Tensor, plain: Tensor, ahead: Tensor, window: Window) -> Tensor:
        """Vectors by kind of token: `noisy` in the horizon, `plain` in the history, else `ahead` (zero if hidden)."""
        return where_tokens(window.generation_tokens, noisy, where_tokens(window.history_tokens, plain, ahead))

    @staticmethod
    def fuse(prediction: Tensor, given: Tensor, window: Window) -> Tensor:
        """Horizon tokens from the prediction, history tokens as given, zero elsewhere; all (B, N, C)."""
        kept = given * window.history_tokens[..., None]
        return torch.where(window.generation_tokens[..., None], prediction.to(given.dtype), kept)

    def on_goals(self, root: Tensor, window: Window) -> Tensor:
        """Root tokens (B, N, 5P), the horizon projected onto the window's root goals if there is a projection."""
        projection = window.projection
        if projection is None:
            return root
        patch = self.config.patch
        frames = root_from_tokens(root, patch)
        end = projection.first + projection.asked.shape[1]
        horizon = projection.apply(self.representation, frames[:, projection.first : end])
        return by_token(torch.cat([frames[:, : projection.first], horizon, frames[:, end:]], dim=1), patch)

    def visible(self, window: Window) -> Tensor:
        """(B, N) bool: the motion tokens that attention may see; a model without constraints sees no future."""
        known = window.history_tokens | window.generation_tokens
        return known | window.future_tokens if self.config.constraints else known
