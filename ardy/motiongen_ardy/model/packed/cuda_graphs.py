"""CudaGraphRecorder: records work as CUDA graphs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import torch

from motiongen_ardy.model.packed.graph_cache import RecordingFailed

_WARM_UPS = 3

Result = TypeVar("Result")


class CudaGraphRecorder:
    """Records CUDA graphs, which share one memory pool. For one device; one thread at a time."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._pool = torch.cuda.graph_pool_handle()
        # One stream for all recordings: libraries keep memory for every stream that they have worked on.
        self._aside = torch.cuda.Stream(device)

    def record(self, work: Callable[[], Result]) -> tuple[Callable[[], None], Result]:
        """As `GraphRecorder.record`. Raises RecordingFailed, or torch.OutOfMemoryError if memory is short."""
        with torch.cuda.device(self._device):
            self._call(work)
            graph = torch.cuda.CUDAGraph()
            try:
                # thread_local: what other threads do meanwhile, such as loading a model, is not captured and not
                # blocked.
                with torch.cuda.graph(graph, self._pool, self._aside, capture_error_mode="thread_local"):
                    result = work()
            except torch.OutOfMemoryError:
                raise
            except RuntimeError as error:
                raise RecordingFailed(f"a CUDA graph could not be recorded: {error}") from error
        return graph.replay, result

    def _call(self, work: Callable[[], Result]) -> None:
        """Warm up: on first calls, libraries choose kernels and allocate memory, which must not be recorded."""
        current = torch.cuda.current_stream(self._device)
        self._aside.wait_stream(current)
        try:
            with torch.cuda.stream(self._aside):
                for _ in range(_WARM_UPS):
                    work()
        finally:  # also on failure: from here on, the memory it reads may be reused
            current.wait_stream(self._aside)
