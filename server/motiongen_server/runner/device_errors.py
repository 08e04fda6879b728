"""Torch's errors of a device in the words of the runner's contract."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from motiongen_server.engine.ports import DeviceLost, OutOfMemory

_NO_HOST_MEMORY = "DefaultCPUAllocator"


@contextmanager
def device_errors() -> Iterator[None]:
    """Raises OutOfMemory or DeviceLost in place of what torch raises for them; other errors pass through."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        torch.cuda.empty_cache()
        raise OutOfMemory(str(error)) from error
    except torch.AcceleratorError as error:
        raise DeviceLost(str(error)) from error
    except MemoryError as error:
        raise OutOfMemory("there is not enough host memory for these rows") from error
    except RuntimeError as error:
        if _NO_HOST_MEMORY in str(error):  # a plain RuntimeError: its text is all that tells it apart
            raise OutOfMemory(str(error)) from error
        raise
