"""How the process keeps its memory."""

from __future__ import annotations

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of malloc.h
KEPT_BYTES = 64 << 20
LARGEST_KEPT_BYTES = 32 << 20
"""Of one block; glibc takes no more."""


def keep_freed_memory() -> bool:
    """Keep what is freed for the next message instead of giving it back to the operating system. True where it can be.

    Messages with frames and tensors are hundreds of kilobytes each, which glibc returns when they are freed and then
    gets back page by page: half of what it costs to send frames.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library, which has other ways
        return False
    return bool(mallopt(_TRIM_THRESHOLD, KEPT_BYTES) and mallopt(_MMAP_THRESHOLD, LARGEST_KEPT_BYTES))
