"""How fast the machine multiplies matrices: the reference for compute efficiency."""

from __future__ import annotations

from collections.abc import Callable

import torch

from tests.bench.clocks import BenchClock

# Large enough for the machine's best rate, small enough to take a moment only.
SIZES = {"cpu": (512, 1024, 1536), "cuda": (2048, 4096, 8192)}


def product_flops_per_s(device: str, dtype: torch.dtype, seconds: float, clock: BenchClock) -> float:
    """The best rate over several sizes of square products, in FLOPs per second; each is tried for so many seconds."""
    return max(_rate(device, dtype, size, seconds, clock) for size in SIZES["cpu" if device == "cpu" else "cuda"])


def waits_for(device: str) -> Callable[[], None]:
    """A function that waits until the device has finished all its work."""
    return (lambda: None) if device == "cpu" else torch.cuda.synchronize


@torch.inference_mode()
def _rate(device: str, dtype: torch.dtype, size: int, seconds: float, clock: BenchClock) -> float:
    left, right = (torch.randn(size, size, device=device).to(dtype) for _ in range(2))
    result = torch.empty(size, size, device=device, dtype=dtype)
    synchronize = waits_for(device)
    torch.mm(left, right, out=result)
    best_s, until = float("inf"), clock.now() + seconds
    while best_s == float("inf") or clock.now() < until:
        synchronize()
        started_s = clock.now()
        torch.mm(left, right, out=result)
        synchronize()
        best_s = min(best_s, clock.now() - started_s)
    return 2 * size**3 / best_s
