"""Chooses the precision of the denoiser's layers."""

from __future__ import annotations

import time

import torch

from motiongen_ardy.model.packed.linear import PackedLinear
from motiongen_ardy.model.precision import PRECISIONS

LEAST_GAIN = 1.5
"""How many times faster products in bfloat16 must be for it to be chosen."""
_WIDTH, _VECTORS, _TIMES = 256, 136, 40


def choose_precision(name: str, device: str) -> torch.dtype:
    """The precision with this name: float32, bfloat16, or auto for bfloat16 if it pays on the device.

    Raises ValueError for another name.
    """
    if name == "auto":
        return torch.bfloat16 if bfloat16_pays(torch.device(device)) else torch.float32
    if name not in PRECISIONS:
        raise ValueError(f"precision is {name!r}; it must be auto, {' or '.join(PRECISIONS)}")
    return PRECISIONS[name]


def bfloat16_pays(device: torch.device) -> bool:
    """Whether the hardware multiplies bfloat16 matrices; on a processor also whether that is fast, as measured now."""
    if not multiplies_bfloat16(device):
        return False
    return device.type != "cpu" or product_s(torch.float32) >= LEAST_GAIN * product_s(torch.bfloat16)


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether the hardware multiplies bfloat16 matrices, rather than emulating it."""
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    if device.type == "cpu":
        return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
    return False


@torch.inference_mode()
def product_s(dtype: torch.dtype) -> float:
    """The least seconds of a product as in a layer for eight windows: others may use the processor too."""
    layer = PackedLinear(torch.ones(2 * _WIDTH, _WIDTH), torch.zeros(2 * _WIDTH), dtype)
    values, least_s = torch.ones(_VECTORS, _WIDTH, dtype=dtype), float("inf")
    for _ in range(_TIMES):
        begun_at = time.perf_counter()
        layer(values)
        least_s = min(least_s, time.perf_counter() - begun_at)
    return least_s
