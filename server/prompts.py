"""Prompt text -> embedding: a cache and one worker thread, beside the denoising loop."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Embedding = NDArray[np.float32]


class TextEncoder(Protocol):
    """What the worker runs; `ardy.text` has implementations."""

    @property
    def identity(self) -> str: ...

    def encode(self, texts: Sequence[str]) -> Embedding: ...


class PromptEncoder:
    """Encodes prompts on a thread of its own and remembers the most recently used.

    Used from the event loop only. The encoder never changes, so the text alone is the key.
    """

    def __init__(self, encoder: TextEncoder, cache_size: int, observe: Callable[[float], None] | None = None) -> None:
        """observe: told the seconds that each encoding took."""
        self._encoder = encoder
        self._cache_size = cache_size
        self._observe = observe
        self._cache: OrderedDict[str, Embedding] = OrderedDict()
        self._running: dict[str, asyncio.Task[Embedding]] = {}
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="prompts")

    @property
    def identity(self) -> str:
        """Name and version of the encoder."""
        return self._encoder.identity

    def cached(self, text: str) -> Embedding | None:
        """The embedding (E,) if it is known already."""
        embedding = self._cache.get(text)
        if embedding is not None:
            self._cache.move_to_end(text)
        return embedding

    async def encode(self, text: str) -> Embedding:
        """The embedding (E,). Whoever asks for a text that is being encoded waits for the same result."""
        embedding = self.cached(text)
        if embedding is not None:
            return embedding
        task = self._running.get(text)
        if task is None:
            task = asyncio.get_running_loop().create_task(self._encode(text))
            self._running[text] = task
        # Shielded: a session that closes while it waits must not take the result from the others.
        return await asyncio.shield(task)

    async def _encode(self, text: str) -> Embedding:
        started = time.monotonic()
        try:
            vectors = await asyncio.get_running_loop().run_in_executor(self._worker, self._encoder.encode, [text])
        finally:
            del self._running[text]
        if self._observe is not None:
            self._observe(time.monotonic() - started)
        embedding: Embedding = vectors[0]
        self._cache[text] = embedding
        while len(self._cache) > self._cache_size:
            self._cache.popitem(last=False)
        return embedding

    def close(self) -> None:
        """End the worker; an encoding that runs is finished first."""
        self._worker.shutdown(wait=True, cancel_futures=True)
