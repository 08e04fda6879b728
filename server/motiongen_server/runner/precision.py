"""Which precision the denoiser's layers are run in."""

from __future__ import annotations

import torch

from motiongen_ardy.model.precision import PRECISIONS


def choose_precision(name: str, device: str) -> torch.dtype:
    """The precision of a name: float32, bfloat16, or auto for bfloat16 where the device multiplies it in hardware.

    Raises ValueError for another name.
    """
    if name == "auto":
        return torch.bfloat16 if multiplies_bfloat16(torch.device(device)) else torch.float32
    if name not in PRECISIONS:
        raise ValueError(f"precision is {name!r}; it must be auto, {' or '.join(PRECISIONS)}")
    return PRECISIONS[name]


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether products of bfloat16 matrices are hardware instructions and not emulated."""
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    if device.type == "cpu":
        return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
    return False
