"""Weights in bfloat16: half the memory, and faster products on processors that support it.

Only weight matrices are held in bfloat16. Norms, biases, positions, statistics and the residual stream stay float32,
and so does everything outside the networks: roots, noise, the quantiser. A network whose matrices are bfloat16
multiplies in bfloat16; its inputs and outputs are float32 either way.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

import torch
from torch import nn

PRECISIONS = {"float32": torch.float32, "bfloat16": torch.bfloat16}
GIVEN = ParamSpec("GIVEN")
RESULT = TypeVar("RESULT")


class InWeightPrecision(nn.Module):
    """A network that multiplies in the precision of its matrices."""

    precision: torch.dtype = torch.float32


NETWORK = TypeVar("NETWORK", bound=InWeightPrecision)


def matrix_names(module: nn.Module) -> set[str]:
    """The names of a module's weight matrices: those of linear layers and of packed attention."""
    names = {f"{name}.weight" for name, part in module.named_modules() if isinstance(part, nn.Linear)}
    packed = {name for name, _ in module.named_parameters() if name.endswith("in_proj_weight")}
    return {name.removeprefix(".") for name in names} | packed


def set_precision(module: nn.Module, dtype: torch.dtype) -> None:
    """Convert the weight matrices of a module to `dtype`; from now on it multiplies in that precision."""
    for name in matrix_names(module):
        parameter = module.get_parameter(name)
        parameter.data = parameter.data.to(dtype)
    for part in module.modules():
        if isinstance(part, InWeightPrecision):
            part.precision = dtype


def in_weight_precision(
    forward: Callable[Concatenate[NETWORK, GIVEN], RESULT],
) -> Callable[Concatenate[NETWORK, GIVEN], RESULT]:
    """Decorator: makes a network's `forward` multiply in the network's precision; results are always float32."""

    @wraps(forward)
    def run(self: NETWORK, *args: GIVEN.args, **kwargs: GIVEN.kwargs) -> RESULT:
        if self.precision == torch.float32:
            return forward(self, *args, **kwargs)
        with torch.autocast(next(self.parameters()).device.type, self.precision):
            return _to_float32(forward(self, *args, **kwargs))

    return run


def _to_float32(result: RESULT) -> RESULT:
    if isinstance(result, tuple):
        return type(result)(_to_float32(part) for part in result)
    return result.float() if isinstance(result, torch.Tensor) else result
