"""AdamAtan2 and the learning-rate schedule."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer

INNER_SCALE = 1.27  # makes a step of |m| = sqrt(v) as long as Adam's: 1.27 * atan2(1, 1) is about 1


class AdamAtan2(Optimizer):
    """Adam with m / (sqrt(v) + eps) replaced by atan2(m, sqrt(v)), which needs no epsilon and is scale invariant.

    The learning rate may be a tensor, which a captured step reads at every replay.
    Everett et al. 2024, "Scaling exponents across parameterizations and optimizers", section 5.
    """

    def __init__(
        self,
        parameters: Iterable[Tensor],
        lr: float | Tensor,
        betas: tuple[float, float] = (0.9, 0.99),
        weight_decay: float = 0.0,
    ) -> None:
        super().__init__(list(parameters), {"lr": lr, "betas": betas, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        """One update of every parameter that has a gradient. A closure is not supported and raises ValueError."""
        if closure is not None:
            raise ValueError("AdamAtan2 takes no closure; compute the loss and its gradients before step()")
        for group in self.param_groups:
            parameters = [parameter for parameter in group["params"] if parameter.grad is not None]
            if not parameters:
                continue
            for parameter in parameters:
                if not self.state[parameter]:
                    self.state[parameter]["mean"] = torch.zeros_like(parameter)
                    self.state[parameter]["square"] = torch.zeros_like(parameter)
            self._update(group, parameters)

    def _update(self, group: dict[str, Any], parameters: list[Tensor]) -> None:
        learning_rate, decay = group["lr"], group["weight_decay"]
        beta_mean, beta_square = group["betas"]
        gradients = [parameter.grad for parameter in parameters]
        means = [self.state[parameter]["mean"] for parameter in parameters]
        squares = [self.state[parameter]["square"] for parameter in parameters]
        # A tensor on the device, so that a captured step increments it by itself.
        step = group.setdefault("step", torch.zeros((), device=parameters[0].device))
        step.add_(1)
        torch._foreach_lerp_(means, gradients, 1 - beta_mean)
        torch._foreach_mul_(squares, beta_square)
        torch._foreach_addcmul_(squares, gradients, gradients, 1 - beta_square)
        if decay:
            torch._foreach_mul_(parameters, 1 - learning_rate * decay)
        # The bias corrections of both averages, 1 - beta^step, as one factor: atan2 depends only on the ratio. Computed
        # with expm1, which keeps precision where the power is almost 1.
        unbiased = torch.expm1(step * math.log(beta_square)).neg().sqrt() / -torch.expm1(step * math.log(beta_mean))
        moves = torch._foreach_mul(means, unbiased)
        spread = torch._foreach_sqrt(squares)
        for move, width in zip(moves, spread, strict=True):
            torch.atan2(move, width, out=move)
        if isinstance(learning_rate, Tensor):
            torch._foreach_mul_(moves, -learning_rate * INNER_SCALE)
            torch._foreach_add_(parameters, moves)
        else:
            torch._foreach_add_(parameters, moves, alpha=-learning_rate * INNER_SCALE)


def warmup_cosine(warmup_steps: int, total_steps: int, floor: float = 0.02) -> Callable[[int], float]:
    """Learning-rate factor by step: linear to 1 over the warm-up, then half a cosine down to `floor`."""

    def factor(step: int) -> float:
        if step < warmup_steps:
            return (step + 1) / warmup_steps
        progress = min(1.0, (step - warmup_steps) / max(1, total_steps - warmup_steps))
        return floor + (1 - floor) * 0.5 * (1 + math.cos(math.pi * progress))

    return factor
