"""Which precision the denoiser's layers are run in."""

from __future__ import annotations

import time

import torch

from motiongen_ardy.model.packed.linear import PackedLinear
from motiongen_ardy.model.precision import PRECISIONS

LEAST_GAIN = 1.5
"""How many times faster products in bfloat16 must be to be taken."""
_WIDTH, _VECTORS, _TIMES = 256, 136, 40


def choose_precision(name: str, device: str) -> torch.dtype:
    """The precision of a name: float32, bfloat16, or auto for bfloat16 where it pays on the device.

    Raises ValueError for another name.
    """
    if name == "auto":
        return torch.bfloat16 if bfloat16_pays(torch.device(device)) else torch.float32
    if name not in PRECISIONS:
        raise ValueError(f"precision is {name!r}; it must be auto, {' or '.join(PRECISIONS)}")
    return PRECISIONS[name]


def bfloat16_pays(device: torch.device) -> bool:
    """Whether products of bfloat16 matrices are hardware instructions, and on a processor fast, as measured now."""
    if not multiplies_bfloat16(device):
        return False
    return device.type != "cpu" or product_s(torch.float32) >= LEAST_GAIN * product_s(torch.bfloat16)


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether products of bfloat16 matrices are hardware instructions and not emulated."""
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    if device.type == "cpu":
        return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
    return False


@torch.inference_mode()
def product_s(dtype: torch.dtype) -> float:
    """The least seconds of a product as a layer of eight windows has it, on the processor: others may use it too."""
    layer = PackedLinear(torch.ones(2 * _WIDTH, _WIDTH), torch.zeros(2 * _WIDTH), dtype)
    values, least_s = torch.ones(_VECTORS, _WIDTH, dtype=dtype), float("inf")
    for _ in range(_TIMES):
        begun_at = time.perf_counter()
        layer(values)
        least_s = min(least_s, time.perf_counter() - begun_at)
    return least_s
