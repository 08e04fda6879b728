"""The two-stage denoiser: predict the clean root, then the clean latents given that root."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH, Representation
from motiongen_ardy.model.config import DenoiserConfig
from motiongen_ardy.model.denoiser.base import Denoiser, leading_columns
from motiongen_ardy.model.denoiser.blocks import StageTransformer
from motiongen_ardy.model.denoiser.goals import Goals
from motiongen_ardy.model.precision import in_weight_precision
from motiongen_ardy.model.tokenizer.model import by_token, root_from_tokens
from motiongen_ardy.model.window import Window


class TwoStageDenoiser(Denoiser):
    """Root stage, then body stage, which reads the local root of the first stage's prediction."""

    def __init__(self, config: DenoiserConfig, representation: Representation) -> None:
        super().__init__(config, representation)
        width = config.transformer.width
        local_width = LOCAL_ROOT_WIDTH * config.patch + config.latent_dim
        self.root_model = StageTransformer(config, self.root_width)
        self.body_model = StageTransformer(config, config.latent_dim)
        self.local_root_hybrid_proj = nn.Linear(local_width, width)
        self.local_root_hybrid_constraints_proj: nn.Linear | None = None
        if config.constraints:
            self.local_root_hybrid_constraints_proj = nn.Linear(local_width + self.goal_width, width)

    @in_weight_precision
    def forward(self, tokens: Tensor, step: Tensor, window: Window) -> Tensor:
        goals = self.goals(window)
        visible = self.visible(window)
        inputs, ahead = self.hybrid_inputs(tokens, goals, window)
        root = self.fuse(self.root_model(inputs, visible, window, step), tokens[..., : self.root_width], window)
        root = self.on_goals(root if window.kept is None else window.kept.over(root), window)
        # The body stage learns from the predicted root but does not train it (paper, section 3.4).
        inputs = self.local_inputs(tokens, root.detach(), goals, ahead, window)
        latent = self.body_model(inputs, visible, window, step)
        latent = self.fuse(latent, tokens[..., self.root_width :], window)
        return torch.cat([root, latent], dim=-1)

    def local_inputs(self, tokens: Tensor, root: Tensor, goals: Goals | None, ahead: Tensor, window: Window) -> Tensor:
        """Input vectors (B, N, width) of the body stage.

        root: (B, N, 5P), the first stage's result; ahead: (B, N, width), the future tokens' vectors, reused.
        """
        lengths = window.history_len + window.generation_len
        patch = self.config.patch
        local = by_token(self.representation.local_root(root_from_tokens(root, patch), lengths), patch)
        known = torch.cat([local, tokens[..., self.root_width :]], dim=-1)
        plain = self.local_root_hybrid_proj(known)
        noisy = plain
        if self.local_root_hybrid_constraints_proj is not None and goals is None:
            noisy = leading_columns(self.local_root_hybrid_constraints_proj, known)
        elif self.local_root_hybrid_constraints_proj is not None and goals is not None:
            told = torch.cat([known, goals.observed_body, goals.mask], dim=-1)
            noisy = self.local_root_hybrid_constraints_proj(told)
        return self.join(noisy, plain, ahead, window)
