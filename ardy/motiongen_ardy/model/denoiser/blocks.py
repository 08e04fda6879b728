"""The transformer of one stage: a prefix of text, step and heading, then the motion tokens."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motiongen_ardy.model.config import MAX_TOKENS, DenoiserConfig
from motiongen_ardy.model.transformer import PositionTable, TransformerStack
from motiongen_ardy.model.window import Window

MAX_STEPS = 1024


class StepEmbedding(nn.Module):
    """Diffusion step index -> (B, 1, width): sinusoidal embedding, then a two-layer perceptron."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.rows = PositionTable(width, 0, MAX_STEPS - 1)
        self.time_embed = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, step: Tensor) -> Tensor:
        """step: (B) int64, base diffusion step."""
        output: Tensor = self.time_embed(self.rows(step)).unsqueeze(1)
        return output


class PrefixEmbedding(nn.Module):
    """Learned vectors that distinguish the prefix tokens."""

    def __init__(self, num_tokens: int, width: int) -> None:
        super().__init__()
        rows = torch.empty(num_tokens, width)
        # On torch's meta device, where a model is built before its weights are loaded, normal_ would import the
        # compiler: 900 more modules and 145 MiB.
        if not rows.is_meta:
            nn.init.normal_(rows)
        self.embedding = nn.Embedding.from_pretrained(rows, freeze=False)


class StageTransformer(nn.Module):
    """The transformer of one stage, with its own prefix."""

    def __init__(self, config: DenoiserConfig, output_width: int) -> None:
        super().__init__()
        width = config.transformer.width
        num_prefix = config.text_tokens + 1 + int(config.heading_token)
        self.embed_text = nn.Linear(config.text_dim, width)
        self.embed_timestep = StepEmbedding(width)
        self.linear_first_heading_angle = nn.Linear(2, width) if config.heading_token else None
        self.relative = config.positions != "default"
        self.learned_prefix_embedding = PrefixEmbedding(num_prefix, width) if self.relative else None
        self.positions = PositionTable(width, -MAX_TOKENS, MAX_TOKENS)
        self.seqTransEncoder = TransformerStack(config.transformer)
        self.output_linear = nn.Linear(width, output_width)
        self.text_tokens = config.text_tokens
        self.use_text_mask = config.use_text_mask

    def prefix(self, window: Window, step: Tensor) -> Tensor:
        """(B, n + 1 or 2, width): text, step and heading tokens plus their learned vectors.

        Too few text vectors are padded with zeros; those beyond what the model takes are cut off.
        """
        text = window.text[:, : self.text_tokens]
        if text.shape[1] < self.text_tokens:
            text = nn.functional.pad(text, (0, 0, 0, self.text_tokens - text.shape[1]))
        parts = [self.embed_text(text), self.embed_timestep(step)]
        if self.linear_first_heading_angle is not None:
            heading = torch.stack([window.heading.cos(), window.heading.sin()], dim=-1)
            parts.append(self.linear_first_heading_angle(heading).unsqueeze(1))
        prefix = torch.cat([part.to(parts[0].dtype) for part in parts], dim=1)
        if self.learned_prefix_embedding is not None:
            prefix = prefix + self.learned_prefix_embedding.embedding.weight
        return prefix

    def forward(self, tokens: Tensor, visible: Tensor, window: Window, step: Tensor) -> Tensor:
        """tokens: (B, N, width), zero where hidden; visible: (B, N) bool; step: (B). -> (B, N, output width)."""
        prefix = self.prefix(window, step)
        if self.relative:
            sequence = torch.cat([prefix, tokens + self.positions(window.token_positions)], dim=1)
        else:
            sequence = torch.cat([prefix, tokens], dim=1)
            sequence = sequence + self.positions(torch.arange(sequence.shape[1], device=sequence.device))
        shown = torch.ones(prefix.shape[:2], dtype=torch.bool, device=tokens.device)
        if self.use_text_mask and window.text_mask is not None:
            given = window.text_mask[:, : self.text_tokens]
            shown[:, : self.text_tokens] = False
            shown[:, : given.shape[1]] = given
        keys = torch.cat([shown, visible], dim=1)[:, None, None, :]
        encoded = self.seqTransEncoder(sequence, keys)
        output: Tensor = self.output_linear(encoded[:, prefix.shape[1] :])
        return output
