"""Graphs on the CPU: operations are recorded once, with the memory that they read and write, and replayed on it.

As with CUDA graphs, none of the program's code runs in a replay, and the results of a replay may be overwritten by
another graph's: a replay sets all numbers that other graphs have made to NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from motiongen_ardy.model.packed.graph_cache import GraphCache

COPIED_OR_AWAITED = ("aten.lift_fresh", "aten._local_scalar_dense", "aten.nonzero", "aten.item", "aten.is_nonzero")

Result = TypeVar("Result")


class _Tape(TorchDispatchMode):
    """Records operations. Fails on a wait for the GPU or a copy to it, since graphs cannot contain these."""

    def __init__(self) -> None:
        super().__init__()
        self.steps: list[Callable[[], None]] = []
        self.made: list[Tensor] = []

    def __torch_dispatch__(self, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        assert not str(operation).startswith(COPIED_OR_AWAITED), f"{operation} in what is recorded"
        named = kwargs or {}
        given = {_memory(one) for one in tree_leaves((args, named)) if isinstance(one, Tensor) and not one.is_mkldnn}
        result = operation(*args, **named)
        made = [one for one in tree_leaves(result) if isinstance(one, Tensor)]
        if operation._schema.is_mutable:
            self.steps.append(lambda: operation(*args, **named))
        elif any(_memory(one) not in given for one in made if one.numel()):  # not a view

            def again() -> None:
                found = [one for one in tree_leaves(operation(*args, **named)) if isinstance(one, Tensor)]
                for held, one in zip(made, found, strict=True):
                    held.copy_(one)

            self.steps.append(again)
            self.made += made
        return result


class TapeRecorder:
    """Satisfies `GraphRecorder`. num_replays, num_recorded: numbers of replays and recordings."""

    def __init__(self) -> None:
        self.num_replays = self.num_recorded = 0
        self._made: list[Tensor] = []  # made by all tapes

    def record(self, work: Callable[[], Result]) -> tuple[Callable[[], None], Result]:
        self.num_recorded += 1
        work()  # fills caches of tables
        with _Tape() as tape:
            result = work()
        steps = tape.steps
        self._made += tape.made

        def replay() -> None:
            self.num_replays += 1
            for one in self._made:
                if one.is_floating_point():
                    one.fill_(torch.nan)
            for step in steps:
                step()

        return replay, result


def eager(recorder: TapeRecorder, most: int = 64) -> GraphCache:
    """A cache that records every shape at its first use."""
    return GraphCache(recorder, most, worth_it=1)


def _memory(tensor: Tensor) -> int:
    return tensor.untyped_storage().data_ptr()
