"""The layer that maps noisy tokens and their constraints to the input vectors of a stage."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motiongen_ardy.model.packed.goal_layers import GoalLayer, TokenGoals
from motiongen_ardy.model.packed.linear import PackedLinear


class InputLayer:
    """A linear layer from tokens, and from the constraints on them, to a stage's input vectors."""

    def __init__(self, plain: nn.Linear, told: nn.Linear | None, order: Tensor, patch: int) -> None:
        """order: the columns of `told` that read a token; its other columns read constraints."""
        noisy = plain if told is None else told
        columns = torch.arange(plain.weight.shape[1], device=order.device) if told is None else order
        self.plain = PackedLinear.of(plain, torch.float32)
        self.noisy = PackedLinear(noisy.weight[:, columns], noisy.bias, torch.float32)
        self._goals: GoalLayer | None = None
        if told is not None:
            weight = told.weight[:, plain.weight.shape[1] :]
            self._goals = GoalLayer(weight, torch.zeros_like(told.bias), patch, reads_root=False)

    def added_by(self, goals: TokenGoals) -> Tensor:
        """What observed body and mask of tokens (n) add to the vectors (n, width) of noisy tokens."""
        if self._goals is None:
            raise ValueError("this model was built without goal inputs")
        return self._goals(goals)
