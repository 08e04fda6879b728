"""What constraints add to input vectors, computed from only the root's columns of a layer where that suffices.

The root and its mask are one in sixty of a layer's inputs, and a velocity, path or waypoint constrains nothing else.
The other inputs are then zeros, which add nothing but would take most of the time.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.packed.linear import PackedLinear


class TokenGoals(NamedTuple):
    """Tokens (n, ...) with constraints: observed root and its mask (n, 5P), observed body (n, P(D-5)), the whole mask
    (n, PD), and whether each constrains more than the root (n); the last is on the CPU, to avoid synchronising.
    """

    root: Tensor
    root_mask: Tensor
    body: Tensor
    mask: Tensor
    beyond_root: Tensor

    @classmethod
    def of(cls, observed: Tensor, mask: Tensor, beyond_root: Tensor) -> TokenGoals:
        """From frames (n, P, D)."""
        root_mask = mask[..., :ROOT_WIDTH]
        return cls(
            (observed[..., :ROOT_WIDTH] * root_mask).flatten(1),
            root_mask.flatten(1),
            observed[..., ROOT_WIDTH:].flatten(1),
            mask.flatten(1),
            beyond_root,
        )

    def between(self, begin: int, end: int) -> TokenGoals:
        """Tokens begin to end - 1."""
        return TokenGoals(*(part[begin:end] for part in self))


class ToldTokens(NamedTuple):
    """The n tokens of B rows that have constraints: first those of the horizon, then those behind it, each by row.

    rows, numbers, beyond_root: (n), on the CPU: a token's row, its number in the window, and whether it constrains more
    than the root. num_here: how many are in the horizon. num_ahead: how many are behind it, by row.
    """

    rows: Tensor
    numbers: Tensor
    beyond_root: Tensor
    num_here: int
    num_ahead: list[int]

    @classmethod
    def of(cls, mask: Tensor, end: int) -> ToldTokens:
        """mask: (B, N, P, D), on the CPU. end: the first token behind the horizon."""
        asked = mask != 0
        beyond = asked[..., ROOT_WIDTH:].flatten(2).any(dim=-1)
        told = beyond | asked[..., :ROOT_WIDTH].flatten(2).any(dim=-1)
        here, ahead = told[:, :end].nonzero(), told[:, end:].nonzero()
        rows = torch.cat([here[:, 0], ahead[:, 0]])
        numbers = torch.cat([here[:, 1], ahead[:, 1] + end])
        return cls(rows, numbers, beyond[rows, numbers], len(here), told[:, end:].sum(dim=1).tolist())


class GoalLayer:
    """A float32 layer whose inputs are a token's observed root (if reads_root), observed body and mask."""

    def __init__(self, weight: Tensor, bias: Tensor, patch: int, *, reads_root: bool) -> None:
        """weight: (width, 5P or 0 + P(D-5) + PD)."""
        self._reads_root = reads_root
        frames = torch.arange(patch, device=weight.device)[:, None]
        root = torch.arange(ROOT_WIDTH * patch if reads_root else 0, device=weight.device)
        features = (weight.shape[1] - len(root) + ROOT_WIDTH * patch) // (2 * patch)
        mask = weight.shape[1] - features * patch + frames * features + torch.arange(ROOT_WIDTH, device=weight.device)
        self._of_all = PackedLinear(weight, bias, torch.float32)
        self._of_root = PackedLinear(weight[:, torch.cat([root, mask.flatten()])], bias, torch.float32)

    @classmethod
    def of(cls, layer: nn.Linear, patch: int) -> GoalLayer:
        """From a torch layer that reads the root too."""
        return cls(layer.weight, layer.bias, patch, reads_root=True)

    def __call__(self, goals: TokenGoals) -> Tensor:
        """(n, width). A token's result does not depend on whether other tokens constrain more than the root."""
        root = [goals.root] if self._reads_root else []
        added = self._of_root(torch.cat([*root, goals.root_mask], dim=1))
        if not bool(goals.beyond_root.any()):
            return added
        whole = self._of_all(torch.cat([*root, goals.body, goals.mask], dim=1))
        return torch.where(goals.beyond_root[:, None].to(added.device), whole, added)
