"""What constraints add to input vectors: by all columns of a layer, or by the few of the root, where no more is asked.

Of a layer's inputs the root and its mask are one in sixty, and a stick, a path or a waypoint asks for nothing else. The
others are zeros then, which add nothing and take most of the time.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.packed.linear import PackedLinear


class TokenGoals(NamedTuple):
    """Tokens (n, ...) with constraints: observed root and its mask (n, 5P), observed body (n, P(D-5)), the whole mask
    (n, PD), and which of them (n) ask for more than the root, on the processor: a device would be waited for.
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
        """Tokens begin to end."""
        return TokenGoals(*(part[begin:end] for part in self))


class ToldTokens(NamedTuple):
    """Which tokens of B rows are told of constraints: n, those of the horizon first, each kind by row.

    rows, numbers, beyond_root: (n) on the processor, a token's row, its number in the window, and whether it is asked
    for more than the root. num_here: those of the horizon. num_ahead: by row, those behind it.
    """

    rows: Tensor
    numbers: Tensor
    beyond_root: Tensor
    num_here: int
    num_ahead: list[int]

    @classmethod
    def of(cls, mask: Tensor, end: int) -> ToldTokens:
        """mask: (B, N, P, D), on the processor. end: the first token behind the horizon."""
        asked = mask != 0
        beyond = asked[..., ROOT_WIDTH:].flatten(2).any(dim=-1)
        told = beyond | asked[..., :ROOT_WIDTH].flatten(2).any(dim=-1)
        here, ahead = told[:, :end].nonzero(), told[:, end:].nonzero()
        rows = torch.cat([here[:, 0], ahead[:, 0]])
        numbers = torch.cat([here[:, 1], ahead[:, 1] + end])
        return cls(rows, numbers, beyond[rows, numbers], len(here), told[:, end:].sum(dim=1).tolist())


class GoalLayer:
    """A float32 layer of which the inputs are a token's observed root, if it reads that, observed body and mask."""

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
        """From a layer of torch that reads the root too."""
        return cls(layer.weight, layer.bias, patch, reads_root=True)

    def __call__(self, goals: TokenGoals) -> Tensor:
        """(n, width). What a token gets depends on itself alone, not on which others ask for more than the root."""
        root = [goals.root] if self._reads_root else []
        added = self._of_root(torch.cat([*root, goals.root_mask], dim=1))
        if not bool(goals.beyond_root.any()):
            return added
        whole = self._of_all(torch.cat([*root, goals.body, goals.mask], dim=1))
        return torch.where(goals.beyond_root[:, None].to(added.device), whole, added)
