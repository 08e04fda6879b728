"""BackgroundLoop: an event loop on its own thread, for callers without asyncio; stopping it ends all that it runs."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import AsyncGenerator, Callable, Coroutine
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from typing import Any, TypeVar

from motiongen_client.errors import MotiongenError, SessionEnded

T = TypeVar("T")
_ON_ITS_THREAD = "this is the client's own thread, which cannot wait for itself: use the client on another one"
_FORKED = (
    "this process was forked from the one with the client, whose thread and connection it does not have: start "
    "processes by spawn (multiprocessing.get_context), and make a client in each"
)


class BackgroundLoop:
    """An event loop on its own thread. All methods may be called from any thread.

    A process forked from this one has the loop without its thread: there, calls raise, and there is nothing to close.
    """

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="motiongen-client", daemon=True)
        self._lock = threading.RLock()  # reentrant: its holder may collect, and so close, a generator
        self._is_ending = False
        self._process = os.getpid()
        self._thread.start()

    @property
    def is_ending(self) -> bool:
        """Whether `stop` was called, so that nothing more is run."""
        return self._is_ending

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine on the loop and wait for what it returns.

        Raises SessionEnded once the client is closed, also in threads that are waiting here then. Raises MotiongenError
        on the loop's own thread, where callbacks of the application run, since that would wait for itself, and in a
        process forked from the loop's.
        """
        if self._is_forked:
            work.close()
            raise MotiongenError(_FORKED)
        if threading.current_thread() is self._thread:
            work.close()
            raise MotiongenError(_ON_ITS_THREAD)
        waiting = self._begin(work)
        if waiting is None:
            raise SessionEnded("client", "the client was closed")
        try:
            return waiting.result()
        except CancelledError:
            raise SessionEnded("client", "the client was closed") from None
        except KeyboardInterrupt:
            waiting.cancel()
            raise

    def call(self, function: Callable[[], T]) -> T:
        """Call a function on the loop's thread and wait for what it returns."""

        async def work() -> T:
            return function()

        return self.run(work())

    def look(self, function: Callable[[], T]) -> T:
        """As `call`, for a function that only reads: it can be called after `stop` too, since nothing changes then."""
        try:
            return self.call(function)
        except SessionEnded:
            return function()

    def finish(self, work: Coroutine[Any, Any, object]) -> None:
        """Run a coroutine that closes something. If the client is closed, there is nothing left to close."""
        if self._is_forked:
            work.close()
            return
        with suppress(SessionEnded):
            self.run(work)

    def leave(self, generator: AsyncGenerator[Any, None]) -> None:
        """Close a generator before anything that is run on the loop later. Does not wait for it.

        Python may collect an abandoned generator on any thread, and the loop's own thread must not wait for itself.
        """

        async def work() -> None:
            await generator.aclose()

        self._begin(work())  # no effect after `stop`, which has closed it

    def stop(self) -> None:
        """End what still runs on the loop, and the thread. May be called again.

        Raises MotiongenError on the loop's own thread.
        """
        if self._is_forked:
            return
        if threading.current_thread() is self._thread:
            raise MotiongenError(_ON_ITS_THREAD)
        with self._lock:
            if self._is_ending:
                return
            self._is_ending = True
        asyncio.run_coroutine_threadsafe(self._end_all(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    @property
    def _is_forked(self) -> bool:
        return os.getpid() != self._process

    def _begin(self, work: Coroutine[Any, Any, T]) -> Future[T] | None:
        """Start a coroutine; None once the loop is ending, since work begun after `_end_all` would never complete."""
        if not self._is_forked:  # otherwise a thread of the other process may hold the lock for ever
            with self._lock:
                if not self._is_ending:
                    return asyncio.run_coroutine_threadsafe(work, self._loop)
        work.close()
        return None

    async def _end_all(self) -> None:
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self._loop.shutdown_asyncgens()
