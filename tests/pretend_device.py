"""A pretended device that computes on the CPU and refuses what a GPU would: tensors of two devices in one operation.

Tensors on it report AWAY as their device; their data is on the CPU. No driver is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

AWAY = torch.device("meta")
_ATEN = torch.ops.aten
# Operations for which a device accepts tensors of the CPU: indices, and copies.
_TAKES_ANY = {
    _ATEN.index.Tensor,
    _ATEN.index_put_.default,
    _ATEN.index_put.default,
    _ATEN.copy_.default,
    _ATEN.to.other,
}


class MixedDevices(AssertionError):
    """Raised for an operation on tensors of two devices."""


class AwayTensor(torch.Tensor):
    """A tensor on the device. held: its data, on the CPU."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> AwayTensor:
        made: AwayTensor = torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls, held.shape, strides=held.stride(), storage_offset=held.storage_offset(), dtype=held.dtype, device=AWAY
        )
        made.held = held
        return made

    @classmethod
    def __torch_dispatch__(
        cls, operation: Any, types: Sequence[type], given: tuple[Any, ...] = (), named: dict[str, Any] | None = None
    ) -> Any:
        return _run(operation, given, named or {})


def _is_away(value: Any) -> bool:
    return isinstance(value, AwayTensor)


def _held(value: Any) -> Any:
    if isinstance(value, AwayTensor):
        return value.held
    return torch.device("cpu") if isinstance(value, torch.device) else value


@torch.inference_mode()
def _away(held: Tensor) -> AwayTensor:
    """Made in inference mode, like tensors while serving: in that mode, no views of other tensors can be taken."""
    return AwayTensor(held)


def _put(value: Any) -> Any:
    return _away(value) if isinstance(value, Tensor) and not _is_away(value) else value


def _run(operation: Any, given: tuple[Any, ...], named: dict[str, Any]) -> Any:
    leaves = [leaf for leaf in tree_leaves((given, named)) if isinstance(leaf, Tensor)]
    away = any(map(_is_away, leaves))
    strangers = [leaf for leaf in leaves if not _is_away(leaf) and leaf.dim()]
    if away and strangers and operation not in _TAKES_ANY:
        raise MixedDevices(f"{operation}: {[tuple(leaf.shape) for leaf in strangers]} are on the CPU, others are not")
    if operation in (_ATEN.index.Tensor, _ATEN.index_put_.default) and away and not _is_away(given[0]):
        raise MixedDevices(f"{operation}: indices on a device into a tensor on the CPU")
    devices = [leaf for leaf in tree_leaves((given, named)) if isinstance(leaf, torch.device)]
    if operation in (_ATEN.to.other,):
        devices = [given[1].device]
    goes_away = AWAY in devices if devices else away
    found = operation(*tree_map(_held, given), **tree_map(_held, named))
    if (
        operation._schema.name.endswith("_")
        and not operation._schema.name.endswith("__")
        and given
        and isinstance(given[0], Tensor)
    ):
        return given[0]
    return tree_map(_put, found) if goes_away else found


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(
        self, operation: Any, types: Sequence[type], given: tuple[Any, ...] = (), named: dict[str, Any] | None = None
    ) -> Any:
        return _run(operation, given, named or {})


def _without_lists(index: Any) -> Any:
    """An index with its lists as tensors: torch would create them on the device, where its own tensors hold no data."""
    if isinstance(index, tuple):
        return tuple(map(_without_lists, index))
    return torch.tensor(index) if isinstance(index, list) else index


class _Makers(TorchFunctionMode):
    """Handles conversions of numbers to tensors, and of tensors to numbers, which are not dispatched as operations."""

    def __torch_function__(
        self, made_by: Callable[..., Any], types: Any, given: tuple[Any, ...] = (), named: dict[str, Any] | None = None
    ) -> Any:
        named = named or {}
        if made_by is torch.Tensor.tolist:
            return _held(given[0]).tolist()
        if made_by is torch.Tensor.numpy and _is_away(given[0]):
            raise MixedDevices("numpy of a tensor that is not on the CPU")
        if made_by in (torch.Tensor.__getitem__, torch.Tensor.__setitem__):
            given = (given[0], _without_lists(given[1]), *given[2:])
        if made_by is torch.Tensor.new_tensor and _is_away(given[0]):
            return _away(given[0].held.new_tensor(*given[1:], **named))
        if made_by is torch.tensor and named.get("device") is not None and torch.device(named["device"]) == AWAY:
            return _away(torch.tensor(*given, **{**named, "device": "cpu"}))
        return made_by(*given, **named)


def carry_away(module: nn.Module) -> None:
    """Move the weights and statistics of a module to the device, in place."""
    for part in module.modules():
        for kind in (part._parameters, part._buffers):
            for name, tensor in kind.items():
                if tensor is not None and not _is_away(tensor):
                    kind[name] = _away(tensor.detach())  # type: ignore[assignment]


@contextmanager
def pretended() -> Iterator[None]:
    """The device exists within this context."""
    with _Makers(), _Operations():
        yield
