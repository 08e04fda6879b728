"""Compiled kernels that nobody needs for now."""

from __future__ import annotations

import os

import torch

DEFAULT_PLACES, MOST_TAKEN = 1024, 4096
"""Places of oneDNN's cache where nobody says another number, and how many of them are taken; each costs 0.1 ms."""


def free_kernels() -> None:
    """Free the products that oneDNN keeps in its cache, for a moment in which nothing is computed.

    oneDNN says how many kernels it keeps but not how to let them go, so that all places are taken by the smallest
    that there are: copies of a few numbers, each of another shape. With 192 places that takes 20 ms and leaves 50 to 80
    MiB less. The first windows after it make their products anew, in 0.3 ms each.
    """
    given = os.environ.get("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "")
    places = int(given) if given.isdigit() else DEFAULT_PLACES
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return
    with torch.inference_mode():
        for count in range(1, min(places, MOST_TAKEN) + 1):
            torch.zeros(count, 1).to_mkldnn()
