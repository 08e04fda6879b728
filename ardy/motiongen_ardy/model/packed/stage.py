"""One stage of the denoiser, split into what is constant over a window's steps and what is not."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.model.denoiser.blocks import StageTransformer
from motiongen_ardy.model.packed.linear import PackedLinear
from motiongen_ardy.model.packed.stack import PackedStack


class PackedStage:
    """A `StageTransformer` whose layers multiply in one precision; inputs and outputs are float32.

    The order of a sequence: text, step, heading, history, horizon, visible future.
    """

    def __init__(self, stage: StageTransformer, num_base_steps: int, dtype: torch.dtype) -> None:
        self._stage = stage
        self.stack = PackedStack(stage.seqTransEncoder, dtype)
        self.num_prefix = stage.text_tokens + 1 + int(stage.linear_first_heading_angle is not None)
        self.step_position = stage.text_tokens
        self.output = PackedLinear.of(stage.output_linear, torch.float32)
        self._text = PackedLinear.of(stage.embed_text, torch.float32)
        heading = stage.linear_first_heading_angle
        no_text = stage.embed_text.weight.new_zeros(1, stage.text_tokens, stage.embed_text.in_features)
        self._no_text = self._marked_prefix(self._text(no_text), 0)
        self._heading = None if heading is None else PackedLinear.of(heading, torch.float32)
        device = stage.output_linear.weight.device
        steps = torch.arange(num_base_steps, device=device)
        self.step_vectors = self._marked_prefix(stage.embed_timestep(steps), self.step_position)[:, 0]

    def _marked_prefix(self, vectors: Tensor, first: int) -> Tensor:
        """Prefix vectors (B, n, width), from prefix token `first` on, plus what distinguishes prefix tokens."""
        count = vectors.shape[1]
        if self._stage.learned_prefix_embedding is not None:
            return vectors + self._stage.learned_prefix_embedding.embedding.weight[first : first + count]
        return vectors + self._stage.positions(torch.arange(first, first + count, device=vectors.device))

    def prefixes(self, text: Tensor, heading: Tensor) -> tuple[Tensor, Tensor]:
        """(B, prefix tokens, width), once with texts (B, n, W) and once without, at headings (B) in radians.

        The step's vector is left at zero.
        """
        texts = self._marked_prefix(self._text(text), 0)
        parts = [torch.zeros_like(texts[:, :1])]
        if self._heading is not None:
            angle = torch.stack([heading.cos(), heading.sin()], dim=-1)
            vector = self._heading(angle).unsqueeze(1)
            parts.append(self._marked_prefix(vector, self.step_position + 1))
        return torch.cat([texts, *parts], dim=1), torch.cat([self._no_text.expand_as(texts), *parts], dim=1)

    def placed(self, vectors: Tensor, history_tokens: int, first_token: int) -> Tensor:
        """Token vectors (..., n, width) plus their positions; first_token: the first one's number in the window."""
        numbers = torch.arange(first_token, first_token + vectors.shape[-2], device=vectors.device)
        return self.placed_at(vectors, history_tokens, numbers)

    def placed_at(self, vectors: Tensor, history_tokens: int, numbers: Tensor) -> Tensor:
        """Token vectors (..., n, width) plus their positions; numbers: (n), of each token in its window."""
        places = numbers - history_tokens if self._stage.relative else numbers + self.num_prefix
        placed: Tensor = vectors + self._stage.positions(places)
        return placed
