"""An event loop on a thread of its own, for callers without asyncio; its end is the end of all that it runs."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable, Coroutine
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from typing import Any, TypeVar

from motiongen_client.errors import MotiongenError, SessionEnded

T = TypeVar("T")
_ON_ITS_THREAD = "this is the client's own thread, which cannot wait for itself: use the client on another one"


class BackgroundLoop:
    """An event loop on a thread of its own. Everything may be used from any thread."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="motiongen-client", daemon=True)
        self._lock = threading.RLock()  # a generator may be collected, and so closed, while this thread holds it
        self._is_ending = False
        self._thread.start()

    @property
    def is_ending(self) -> bool:
        """Whether nothing more is run on it."""
        return self._is_ending

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine on the loop and wait for what it returns.

        Raises SessionEnded once the client is closed, also in threads that wait here at that moment, and MotiongenError
        on the loop's own thread, where functions of the application are called: it would wait for itself.
        """
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

    def finish(self, work: Coroutine[Any, Any, object]) -> None:
        """Run a coroutine that ends something; where the client is closed, it has ended already."""
        with suppress(SessionEnded):
            self.run(work)

    def leave(self, generator: AsyncGenerator[Any, None]) -> None:
        """Close a generator before anything else that is asked of the loop from now on. Does not wait for it.

        Python may collect what was left early on any thread; the loop's own must not wait for itself.
        """

        async def work() -> None:
            await generator.aclose()

        self._begin(work())  # after the end, which has closed it, there is nothing to do

    def stop(self) -> None:
        """End what still runs on the loop, and the thread. May be called again. Raises MotiongenError as `run` does."""
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

    def _begin(self, work: Coroutine[Any, Any, T]) -> Future[T] | None:
        """None where the loop ends or has ended: what began after `_end_all` would never be done."""
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
