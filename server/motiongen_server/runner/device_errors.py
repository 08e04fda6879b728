"""Turns torch's errors about a device into those of the runner's contract."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch

from motiongen_ardy.model.packed.graph_cache import RecordingFailed
from motiongen_server.engine.ports import DeviceLost, OutOfMemory

_NO_HOST_MEMORY = "DefaultCPUAllocator"
_NO_DEVICE_MEMORY = "out of memory"  # the driver's, for example when a graph is prepared: not an OutOfMemoryError


@contextmanager
def device_errors(let_go: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Raise OutOfMemory or DeviceLost in place of torch's errors for them; other errors pass through.

    let_go: frees what holds device memory and can be made again; called when memory has run out.
    """

    def no_room(error: Exception) -> OutOfMemory:
        let_go()
        torch.cuda.empty_cache()
        return OutOfMemory(str(error))

    try:
        yield
    except torch.OutOfMemoryError as error:
        raise no_room(error) from error
    except RecordingFailed as error:
        raise DeviceLost(f"{error}; with --cuda-graphs false no graphs are recorded") from error
    except torch.AcceleratorError as error:
        if _NO_DEVICE_MEMORY in str(error):
            raise no_room(error) from error
        raise DeviceLost(str(error)) from error
    except MemoryError as error:
        raise OutOfMemory("there is not enough host memory for these rows") from error
    except RuntimeError as error:
        if _NO_HOST_MEMORY in str(error):  # a plain RuntimeError, which only its text tells apart
            raise OutOfMemory(str(error)) from error
        raise
