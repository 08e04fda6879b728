"""What stays constant for a row while its window is denoised, as the vectors that the stages read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from motiongen_ardy.model.denoiser.guidance import Pass
from motiongen_ardy.model.sampling.projection import RootProjection


class WindowVectors(NamedTuple):
    """Vectors of B rows, without constraints. S stages, P prefix tokens, N_h history tokens.

    told, untold: (B, S, P, width), the prefix with the rows' texts, and without. history, decided, last: (B, ...), as
    in `RowConditions`.
    """

    told: Tensor
    untold: Tensor
    history: Tensor
    decided: Tensor
    last: Tensor


@dataclass(frozen=True, slots=True)
class RowGoals:
    """A row's constraints. S stages, G horizon tokens, F visible future tokens.

    horizon: (S, G, width), what they add to the horizon's input vectors. future: (S, F, width), with positions added.
    root, root_mask: (G, 5P), the observed root and where it overwrites the noisy one.
    """

    horizon: Tensor
    future: Tensor
    root: Tensor
    root_mask: Tensor


@dataclass(frozen=True, slots=True)
class RowConditions:
    """The conditions of one row. S stages, P prefix tokens, N_h history tokens.

    prefixes: of each pass, (S, P, width). history: (N_h, width), first-stage vectors with positions added. decided:
    (N_h - 1 or 0, width), those of the second stage, without the last history token, whose vector depends on the frame
    after it. last: (5P + L), that token; zeros without history. projection: of this row alone.
    """

    passes: tuple[Pass, ...]
    prefixes: Sequence[Tensor]
    history: Tensor
    decided: Tensor
    last: Tensor
    goals: RowGoals | None
    projection: RootProjection | None = None

    @property
    def history_tokens(self) -> int:
        return self.history.shape[0]

    def told(self, index: int) -> RowGoals | None:
        """The constraints that pass number `index` sees."""
        return self.goals if self.passes[index].with_constraints else None

    def future_tokens(self, index: int) -> int:
        """How many future tokens pass number `index` sees."""
        goals = self.told(index)
        return 0 if goals is None else goals.future.shape[1]
