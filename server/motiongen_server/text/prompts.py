"""Prompt text -> embedding, beside the denoising loop: kept in memory, kept on the disk, or asked of the encoder."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from motiongen_server.errors import EventRefused
from motiongen_server.text.event_errors import encoder_away, encoder_busy, encoder_slow
from motiongen_server.text.turns import Asker, Place, PlaceLost, Turns

_log = logging.getLogger(__name__)

Embedding = NDArray[np.float32]

ENCODING_THREADS = 4
"""For encoders elsewhere, which can take several at once; one in this process takes its turns itself."""
NOBODY = Asker()
"""Who asks on nobody's behalf."""
QUIET_S = 10.0
"""A failing encoder is mentioned in the log so often."""


class TextEncoder(Protocol):
    """What the workers run; `motiongen_ardy.text` has implementations.

    encode raises ConnectionError where the encoder cannot answer now, with a message that may be told to clients, and
    may give that an attribute `retry_after_s`.
    """

    @property
    def identity(self) -> str: ...

    def encode(self, texts: Sequence[str]) -> Embedding: ...


@runtime_checkable
class Closeable(Protocol):
    """An encoder that has calls under way which can be ended."""

    def close(self) -> None: ...


class Store(Protocol):
    """Where embeddings outlive the process; it never fails, it only forgets."""

    def get(self, text: str) -> Embedding | None: ...

    def put(self, text: str, vector: Embedding) -> None: ...

    def close(self) -> None: ...


class PromptEncoder:
    """Encodes prompts on threads of its own and remembers the most recently used.

    Used from the event loop only. The encoder never changes, so the text alone is the key. Prompts that are kept never
    wait for the encoder, in whatever state it is.
    """

    def __init__(
        self,
        encoder: TextEncoder,
        cache_size: int,
        *,
        observe: Callable[[float], None] | None = None,
        store: Store | None = None,
        timeout_s: float = 10.0,
        max_waiting: int = 256,
        count: Callable[[str], None] | None = None,
    ) -> None:
        """observe: told the seconds that each encoding took. timeout_s: longest that one who asks waits.

        max_waiting: texts that may be at the encoder or wait for it; one more is refused, or the newest of the peer
        that has most. count: told where each text that was not in memory came from ("store", "encoder"), or the reason
        for which it did not come.
        """
        self._count = count or (lambda what: None)
        self._encoder = encoder
        self._cache_size = cache_size
        self._observe = observe
        self._store = store
        self._timeout_s = timeout_s
        self._max_waiting = max_waiting
        self._cache: OrderedDict[str, Embedding] = OrderedDict()
        self._running: dict[str, tuple[asyncio.Task[Embedding], Place]] = {}
        self._turns = Turns(ENCODING_THREADS, max_waiting)
        self._workers = ThreadPoolExecutor(ENCODING_THREADS, thread_name_prefix="prompts")
        # Its own, so that what is on the disk does not wait behind what has to be encoded.
        self._manager = ThreadPoolExecutor(1, thread_name_prefix="prompt-store")
        self._quiet_until = 0.0

    @property
    def identity(self) -> str:
        """Name and version of the encoder."""
        return self._encoder.identity

    @property
    def num_waiting(self) -> int:
        """Texts that are under way."""
        return len(self._running)

    def cached(self, text: str) -> Embedding | None:
        """The embedding (E,) if it is known already."""
        embedding = self._cache.get(text)
        if embedding is not None:
            self._cache.move_to_end(text)
        return embedding

    def remember(self, text: str, embedding: Embedding) -> None:
        """Know a text's embedding (E,) from now on."""
        self._cache[text] = embedding
        while len(self._cache) > self._cache_size:
            self._cache.popitem(last=False)

    async def encode(self, text: str, asker: Asker = NOBODY) -> Embedding:
        """The embedding (E,). Whoever asks for a text that is being encoded waits for the same result.

        asker: peers take turns, and who asks within them; where all places are taken, the peer that has most gives up
        one. Raises EventRefused when the encoder is slow (the text is still encoded, for the next who asks), busy or
        away.
        """
        embedding = self.cached(text)
        if embedding is not None:
            return embedding
        if text in self._running:
            task, place = self._running[text]
            self._turns.join(place, asker)
        else:
            place = Place(asker)
            task = asyncio.get_running_loop().create_task(self._encode(text, place))
            task.add_done_callback(_retrieve)
            self._running[text] = task, place
        try:
            # Shielded: a session that closes while it waits must not take the result from the others.
            return await asyncio.wait_for(asyncio.shield(task), self._timeout_s)
        except TimeoutError:
            self._complain("the text encoder has not answered within %g s", self._timeout_s)
            raise self._refused(encoder_slow(self._timeout_s)) from None

    async def _encode(self, text: str, place: Place) -> Embedding:
        loop = asyncio.get_running_loop()
        try:
            kept = None if self._store is None else await loop.run_in_executor(self._manager, self._store.get, text)
            embedding = await self._ask(text, place) if kept is None else kept
        finally:
            del self._running[text]
        self._count("encoder" if kept is None else "store")
        self.remember(text, embedding)
        if kept is None and self._store is not None:
            self._manager.submit(self._store.put, text, embedding)
        return embedding

    async def _ask(self, text: str, place: Place) -> Embedding:
        started = time.monotonic()
        loop = asyncio.get_running_loop()
        try:
            await self._turns.take(place)
        except PlaceLost:
            raise self._refused(encoder_busy(self._max_waiting)) from None
        try:
            vectors = await loop.run_in_executor(self._workers, self._encoder.encode, [text])
        except ConnectionError as error:
            self._complain("a prompt could not be encoded: %s", error)
            raise self._refused(encoder_away(error)) from error
        finally:
            self._turns.give_back()
        if self._observe is not None:
            self._observe(time.monotonic() - started)
        embedding: Embedding = vectors[0]
        return embedding

    def _refused(self, refusal: EventRefused) -> EventRefused:
        self._count(refusal.reason)
        return refusal

    def _complain(self, message: str, *values: object) -> None:
        """Log it, unless something like it was logged just now: an encoder that is down fails every prompt."""
        now = time.monotonic()
        if now >= self._quiet_until:
            self._quiet_until = now + QUIET_S
            _log.warning(message, *values)

    def close(self) -> None:
        """End the workers. Calls of an encoder elsewhere are broken off; an encoding in this process is finished."""
        if isinstance(self._encoder, Closeable):
            self._encoder.close()
        self._workers.shutdown(wait=True, cancel_futures=True)
        self._manager.shutdown(wait=True)
        if self._store is not None:
            self._store.close()


def _retrieve(task: asyncio.Task[Embedding]) -> None:
    """Look at how it ended: all who asked may have given up, and asyncio complains of failures nobody saw."""
    if not task.cancelled():
        task.exception()
