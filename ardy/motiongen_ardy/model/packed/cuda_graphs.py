"""CudaGraphRecorder: records CUDA graphs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import torch

from motiongen_ardy.model.packed.graph_cache import RecordingFailed

_WARM_UPS = 3

Result = TypeVar("Result")


class CudaGraphRecorder:
    """Records CUDA graphs, which share one pool of memory. For one device; one thread at a time."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._pool = torch.cuda.graph_pool_handle()
        # One for all: libraries keep memory for every stream that they have ever worked on.
        self._aside = torch.cuda.Stream(device)

    def record(self, work: Callable[[], Result]) -> tuple[Callable[[], None], Result]:
        """As `GraphRecorder.record`. Raises RecordingFailed; torch.OutOfMemoryError where memory is short."""
        with torch.cuda.device(self._device):
            self._call(work)
            graph = torch.cuda.CUDAGraph()
            try:
                # What other threads do meanwhile, as to load another model, is no part of it and need not be held up.
                with torch.cuda.graph(graph, self._pool, self._aside, capture_error_mode="thread_local"):
                    result = work()
            except torch.OutOfMemoryError:
                raise
            except RuntimeError as error:
                raise RecordingFailed(f"a CUDA graph could not be recorded: {error}") from error
        return graph.replay, result

    def _call(self, work: Callable[[], Result]) -> None:
        """Libraries choose kernels and take their memory when they are first called, which must not be recorded."""
        current = torch.cuda.current_stream(self._device)
        self._aside.wait_stream(current)
        try:
            with torch.cuda.stream(self._aside):
                for _ in range(_WARM_UPS):
                    work()
        finally:  # also where it fails: what it reads may be used for something else from here on
            current.wait_stream(self._aside)
