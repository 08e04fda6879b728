"""The one-stage denoiser of the paper's ablation: predicts root and latents at once."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.config import DenoiserConfig
from motiongen_ardy.model.denoiser.base import Denoiser
from motiongen_ardy.model.denoiser.blocks import StageTransformer
from motiongen_ardy.model.precision import in_weight_precision
from motiongen_ardy.model.window import Window


class OneStageDenoiser(Denoiser):
    """One transformer with the inputs of the root stage, whose output is a whole hybrid token."""

    def __init__(self, config: DenoiserConfig, representation: Representation) -> None:
        super().__init__(config, representation)
        self.root_model = StageTransformer(config, self.root_width + config.latent_dim)

    @in_weight_precision
    def forward(self, tokens: Tensor, step: Tensor, window: Window) -> Tensor:
        inputs, _ = self.hybrid_inputs(tokens, self.goals(window), window)
        result = self.fuse(self.root_model(inputs, self.visible(window), window, step), tokens, window)
        root = self.on_goals(result[..., : self.root_width], window)
        return torch.cat([root, result[..., self.root_width :]], dim=-1)
