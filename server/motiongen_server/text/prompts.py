"""Prompt text -> embedding: from the cache in memory, from the store on disk, or from the encoder."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from motiongen_server.errors import EventRefused
from motiongen_server.text.event_errors import encoder_away, encoder_busy, encoder_slow
from motiongen_server.text.kept import KeptPrompts
from motiongen_server.text.ports import Answer, Closeable, Embedding, Store, TextEncoder, answers_to
from motiongen_server.text.turns import Asker, Place, PlaceLost, Turns

_log = logging.getLogger(__name__)

ENCODING_THREADS = 4
"""For remote encoders, which can take several calls at once; one in this process takes them in turn by itself."""
MOST_TOGETHER = 16
"""Texts of one asker in one call of the encoder: a call has a cost of its own."""
TOGETHER_S = 0.005
"""How long a call with several texts may take, estimated from the last call, so that others' turns are not delayed."""
NOBODY = Asker()
"""For texts that are encoded on nobody's behalf."""
QUIET_S = 10.0
"""A failing encoder is logged at most once in this time."""


class PromptEncoder:
    """Encodes prompts on threads of its own and remembers the most recently used.

    Used from the event loop only. The encoder never changes, so the text alone is the key. Cached prompts never wait
    for the encoder, whatever state it is in.
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
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """observe: called with the seconds that each text took at the encoder, waiting included. timeout_s: how long a
        caller waits for a text.

        max_waiting: calls that may be at the encoder or wait for it; beyond that a new one is refused, or the newest of
        the peer that has the most. As many calls of the store may wait; beyond that, texts go to the encoder without
        asking the store. count: called for each text that was not in memory, with its source ("store", "encoder") or
        the reason of its refusal. clock: seconds since any moment.
        """
        self._count = count or (lambda what: None)
        self._encoder = encoder
        self._cache_size = cache_size
        self._observe = observe
        self._kept = None if store is None else KeptPrompts(store, max_waiting, self._complain)
        self._timeout_s = timeout_s
        self._max_waiting = max_waiting
        self._cache: OrderedDict[str, Embedding] = OrderedDict()
        self._clock = clock
        self._running: dict[str, tuple[asyncio.Future[Embedding], Place]] = {}
        self._calls: set[asyncio.Task[None]] = set()  # of `_encode`; the event loop keeps only weak references
        self._together = 1  # texts in the next call
        self._turns = Turns(ENCODING_THREADS, max_waiting)
        self._workers = ThreadPoolExecutor(ENCODING_THREADS, thread_name_prefix="prompts")
        self._quiet_until = -math.inf

    @property
    def identity(self) -> str:
        """Name and version of the encoder."""
        return self._encoder.identity

    @property
    def num_waiting(self) -> int:
        """Texts that are being looked up or encoded, or wait for that."""
        return len(self._running)

    def cached(self, text: str) -> Embedding | None:
        """The embedding (E,) if it is in the cache."""
        embedding = self._cache.get(text)
        if embedding is not None:
            self._cache.move_to_end(text)
        return embedding

    def remember(self, text: str, embedding: Embedding) -> None:
        """Put a text's embedding (E,) into the cache."""
        self._cache[text] = embedding
        while len(self._cache) > self._cache_size:
            self._cache.popitem(last=False)

    async def encode(self, text: str, asker: Asker = NOBODY) -> Embedding:
        """The embedding (E,). Callers that ask for the same text at the same time share its result.

        asker: peers take turns at the encoder, and so do the askers of a peer; if all places are taken, the peer with
        the most gives up one. Raises EventRefused if the encoder is slow (it still finishes the text, for later
        callers), busy or unavailable.
        """
        return (await self.encode_all((text,), asker))[text]

    async def encode_all(self, texts: Sequence[str], asker: Asker = NOBODY) -> dict[str, Embedding]:
        """The embedding (E,) of each text, as from `encode`, one after the other.

        A fast encoder gets several texts in one call, which takes one place.
        """
        found: dict[str, Embedding] = {}
        begun: dict[str, asyncio.Future[Embedding]] = {}
        for number, text in enumerate(texts):
            if text in found:
                continue
            if text not in begun:
                if (embedding := self.cached(text)) is not None:
                    found[text] = embedding
                    continue
                begun |= self._join(text, asker) if text in self._running else self._begin(texts[number:], asker)
            found[text] = await self._answer(begun[text])
        return found

    def _join(self, text: str, asker: Asker) -> Mapping[str, asyncio.Future[Embedding]]:
        answer, place = self._running[text]
        self._turns.join(place, asker)
        return {text: answer}

    def _begin(self, texts: Sequence[str], asker: Asker) -> Mapping[str, asyncio.Future[Embedding]]:
        """Start encoding the first of the texts, as many as one call takes."""
        new = [text for text in dict.fromkeys(texts) if text not in self._cache and text not in self._running]
        loop, place = asyncio.get_running_loop(), Place(asker)
        answers = {text: loop.create_future() for text in new[: self._together]}
        for text, answer in answers.items():
            answer.add_done_callback(_retrieve)
            self._running[text] = answer, place
        call = loop.create_task(self._encode(answers, place))
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)
        return answers

    async def _answer(self, answer: asyncio.Future[Embedding]) -> Embedding:
        try:
            # Shielded: a session that closes while it waits must not take the result from the others.
            return await asyncio.wait_for(asyncio.shield(answer), self._timeout_s)
        except TimeoutError:
            self._complain("the text encoder has not answered within %g s", self._timeout_s)
            raise self._refused(encoder_slow(self._timeout_s)) from None

    async def _encode(self, answers: Mapping[str, asyncio.Future[Embedding]], place: Place) -> None:
        """Get the embeddings and resolve every answer, whatever happens."""
        texts = tuple(answers)
        try:
            if self._kept is not None:
                kept = await self._kept.find(texts)
                self._tell(kept, answers, "store")
                texts = tuple(text for text in texts if text not in kept)
            if texts:
                self._tell(await self._ask(texts, place), answers, "encoder")
        except Exception as error:
            self._tell({text: error for text in texts if not answers[text].done()}, answers, "")
        finally:
            for text, answer in answers.items():
                if answer.cancel():  # the event loop ends before the encoder answers
                    del self._running[text]

    async def _ask(self, texts: Sequence[str], place: Place) -> Mapping[str, Answer]:
        """The encoder's answer to each text. Raises EventRefused if there is no place."""
        started = self._clock()
        try:
            await self._turns.take(place)
        except PlaceLost:
            raise encoder_busy(self._max_waiting) from None
        try:
            loop = asyncio.get_running_loop()
            said, call_s = await loop.run_in_executor(self._workers, self._call, texts)
        finally:
            self._turns.give_back()
        if not any(isinstance(vector, Exception) for vector in said.values()):  # a failure may be fast
            self._together = min(max(1, int(TOGETHER_S * len(texts) / max(call_s, 1e-9))), MOST_TOGETHER)
        if self._observe is not None:
            took_s = self._clock() - started
            for vector in said.values():
                if not isinstance(vector, Exception):
                    self._observe(took_s)
        return said

    def _call(self, texts: Sequence[str]) -> tuple[Mapping[str, Answer], float]:
        """Runs on an encoding thread. Returns the answers and the seconds that the call took."""
        started = self._clock()
        said = answers_to(texts, self._encoder)
        return said, self._clock() - started

    def _tell(
        self,
        said: Mapping[str, Answer],
        answers: Mapping[str, asyncio.Future[Embedding]],
        source: str,
    ) -> None:
        """Answer those who wait for these texts, and cache the vectors. source: where they came from, for `count`."""
        for text, vector in said.items():
            del self._running[text]
            if isinstance(vector, Exception):
                answers[text].set_exception(self._refusal_for(vector))
                continue
            self._count(source)
            self.remember(text, vector)
            answers[text].set_result(vector)
        if self._kept is not None and source == "encoder":
            self._kept.keep({text: vector for text, vector in said.items() if not isinstance(vector, Exception)})

    def _refusal_for(self, error: Exception) -> Exception:
        """The refusal for an encoder's error; any other exception is a fault, and is returned as it is."""
        if isinstance(error, EventRefused):
            return self._refused(error)
        if not isinstance(error, ConnectionError):
            return error
        self._complain("a prompt could not be encoded: %s", error)
        refusal = self._refused(encoder_away(error))
        refusal.__cause__ = error
        return refusal

    def _refused(self, refusal: EventRefused) -> EventRefused:
        self._count(refusal.reason)
        return refusal

    def _complain(self, message: str, *values: object) -> None:
        """Log a warning, at most one in `QUIET_S`: an encoder that is down fails every prompt."""
        now = self._clock()
        if now >= self._quiet_until:
            self._quiet_until = now + QUIET_S
            _log.warning(message, *values)

    def close(self) -> None:
        """End the threads. Calls to a remote encoder are cancelled; an encoding in this process is finished."""
        if isinstance(self._encoder, Closeable):
            self._encoder.close()
        self._workers.shutdown(wait=True, cancel_futures=True)
        if self._kept is not None:
            self._kept.close()


def _retrieve(answer: asyncio.Future[Embedding]) -> None:
    """Retrieve a failure: all callers may have given up, and asyncio logs failures that nobody has retrieved."""
    if not answer.cancelled():
        answer.exception()
