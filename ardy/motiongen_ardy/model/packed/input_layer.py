"""A layer from noisy tokens, and what constraints ask of them, to the vectors that a stage reads."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motiongen_ardy.model.packed.goal_layers import GoalLayer, TokenGoals
from motiongen_ardy.model.packed.linear import PackedLinear


class InputLayer:
    """A linear layer from tokens, and from constraints beside them, to a stage's input vectors."""

    def __init__(self, plain: nn.Linear, told: nn.Linear | None, order: Tensor, patch: int) -> None:
        """order: which columns of `told` belong to the columns of a token; the others are the constraints'."""
        noisy = plain if told is None else told
        columns = torch.arange(plain.weight.shape[1], device=order.device) if told is None else order
        self.plain = PackedLinear.of(plain, torch.float32)
        self.noisy = PackedLinear(noisy.weight[:, columns], noisy.bias, torch.float32)
        self._goals: GoalLayer | None = None
        if told is not None:
            weight = told.weight[:, plain.weight.shape[1] :]
            self._goals = GoalLayer(weight, torch.zeros_like(told.bias), patch, reads_root=False)

    def added_by(self, goals: TokenGoals) -> Tensor:
        """What observed body and mask of tokens (n) add to the vectors (n, width) of noisy ones."""
        if self._goals is None:
            raise ValueError("this model was built without goal inputs")
        return self._goals(goals)
