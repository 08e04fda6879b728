"""MovingAverage: averages the weights; the average is what is kept of a training."""

from __future__ import annotations

import copy
from typing import Any

import torch
import torch.distributed
from torch import nn


class MovingAverage:
    """Exponential moving average of a module's weights, whose span grows from nothing to 1 / (1 - decay) updates.

    With a constant decay, the untrained weights would still count after thousands of steps.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.module = copy.deepcopy(module).requires_grad_(False)
        self.decay = decay
        self.count = torch.zeros((), device=next(module.parameters()).device)

    @torch.no_grad()
    def update(self, module: nn.Module, steps: int = 1) -> None:
        """Move towards the module's current weights, by as much as `steps` single updates would."""
        share = 1 - torch.clamp((1 + self.count) / (10 + self.count), max=self.decay) ** steps
        averaged = list(self.module.parameters())
        moves = torch._foreach_sub([parameter.detach() for parameter in module.parameters()], averaged)
        torch._foreach_mul_(moves, share)
        torch._foreach_add_(averaged, moves)
        self.count.add_(steps)

    def state_dict(self) -> dict[str, Any]:
        return {"module": self.module.state_dict(), "count": self.count}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.module.load_state_dict(state["module"])
        self.count.copy_(state["count"])
