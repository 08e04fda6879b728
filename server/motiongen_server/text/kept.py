"""Uses the store of embeddings without blocking the event loop. It only saves time: few calls wait for it, briefly."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from motiongen_server.text.ports import Embedding, Store

T = TypeVar("T")

STORE_WAIT_S = 0.5
"""How long a text waits for the store, which answers in microseconds unless its disk is slow or its file is locked."""


class KeptPrompts:
    """A store on a thread of its own. Used from the event loop, except `close`.

    While a call of the store takes too long, or too many wait, no texts are found and no vectors are stored.
    """

    def __init__(self, store: Store, most: int, complain: Callable[[str, object], None]) -> None:
        """most: calls of the store that may run or wait. complain: called with what to log when the store is slow."""
        self._store = store
        self._complain = complain
        self._places = threading.Semaphore(most)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="prompt-store")
        self._late: Future[Mapping[str, Embedding]] | None = None

    async def find(self, texts: Sequence[str]) -> Mapping[str, Embedding]:
        """The embeddings (E,) of those texts that the store has; none if it does not answer."""
        call: Future[Mapping[str, Embedding]] | None = self._begin(lambda: _known_to(self._store, texts))
        if call is None:
            return {}
        answer = asyncio.wrap_future(call)
        answer.add_done_callback(_retrieve)
        try:
            # Shielded: the call continues, and keeps its place until it is over.
            return await asyncio.wait_for(asyncio.shield(answer), STORE_WAIT_S)
        except TimeoutError:
            self._late = call
            self._complain("the prompt store has not answered within %g s; prompts are encoded anew", STORE_WAIT_S)
            return {}

    def keep(self, vectors: Mapping[str, Embedding]) -> None:
        """Store the vectors of texts."""
        self._begin(lambda: _keep(self._store, vectors))

    @property
    def _is_late(self) -> bool:
        return self._late is not None and not self._late.done()

    def close(self) -> None:
        """Finish the waiting calls, unless the store is late, and close it."""
        self._thread.shutdown(wait=True, cancel_futures=self._is_late)
        self._store.close()

    def _begin(self, work: Callable[[], T]) -> Future[T] | None:
        """Do it on the thread; None if there is no place, or an earlier call is late."""
        if self._is_late or not self._places.acquire(blocking=False):
            return None

        def in_its_place() -> T:
            try:
                return work()
            finally:
                self._places.release()

        return self._thread.submit(in_its_place)


def _known_to(store: Store, texts: Sequence[str]) -> Mapping[str, Embedding]:
    kept = {text: store.get(text) for text in texts}
    return {text: embedding for text, embedding in kept.items() if embedding is not None}


def _keep(store: Store, vectors: Mapping[str, Embedding]) -> None:
    for text, vector in vectors.items():
        store.put(text, vector)


def _retrieve(answer: asyncio.Future[Mapping[str, Embedding]]) -> None:
    """Retrieve a failure: the caller may have stopped waiting, and asyncio logs failures that nobody has retrieved."""
    if not answer.cancelled():
        answer.exception()
