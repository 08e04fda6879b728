"""How the process keeps its memory."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # M_TRIM_THRESHOLD and so on in malloc.h
KEPT_BYTES = 64 << 20
LARGEST_KEPT_BYTES = 32 << 20
"""Of one block; glibc takes no more."""
FIRST_LOOKS, MOST_LOOKS = 8, 128
"""After a try to give back memory: so many looks later comes another, and twice as many after each, up to the last."""
COLLECT_EVERY = (50_000, 10, 10)
"""Objects made and not yet gone, then collections of the younger ones: Python's default is 700, 10, 10."""


def keep_freed_memory() -> bool:
    """Keep what is freed for the next message instead of giving it back to the operating system. True where it can be.

    Messages with frames and tensors are hundreds of kilobytes each, which glibc returns when they are freed and then
    gets back page by page: half of what it costs to send frames.
    """
    return _set_malloc(_TRIM_THRESHOLD, KEPT_BYTES) and _set_malloc(_MMAP_THRESHOLD, LARGEST_KEPT_BYTES)


def use_one_arena() -> bool:
    """Have all threads take memory from the main arena, before the first of them does. True where it can be.

    malloc_trim gives back the end of the main arena alone: that of an arena of a thread's own stays as long as its
    highest peak was, of which there is a higher one ever more seldom. For processes in which one thread does the work.
    """
    return _set_malloc(_ARENA_MAX, 1)


def _set_malloc(parameter: int, value: int) -> bool:
    try:
        return bool(ctypes.CDLL(None).mallopt(parameter, value))
    except (AttributeError, OSError, TypeError):  # another C library, which has other ways
        return False


def give_back_freed_memory() -> bool:
    """Give what is free by now back to the operating system, once. True where that can be.

    For the end of loading: that and measuring a model take more memory than serving it ever does again.
    """
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library
        return False
    return bool(trim(0))


def free_garbage() -> None:
    """Free rings of objects that nobody holds any more, for a moment in which nothing is done.

    Within `settled_objects` they are looked for so rarely that those of thousands of sessions add up; all that is
    settled is left out, so it takes a few milliseconds.
    """
    gc.collect()


def resident_bytes(pid: int) -> int:
    """Memory of a process, what it shares with others included; 0 where that is not known."""
    try:
        return resource.getpagesize() * int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError, ValueError):  # it has just ended, or this system has no /proc
        return 0


class FreedMemory:
    """Tells when memory is worth giving back: after a peak that is over, and when nothing is done any more.

    What is in use every day stays meanwhile. Of sessions of all lengths that come and go, pieces are left between what
    lives longer: a day of them would leave more and more. What a peak has taken may be in use still when it is seen, as
    calls are that wait for the event loop, so it is tried again a few times, ever more seldom.
    """

    def __init__(self, resident_bytes_of_process: Callable[[], int] | None = None) -> None:
        self._resident_bytes = resident_bytes_of_process or (lambda: resident_bytes(os.getpid()))
        self._kept: int | None = None
        self._was_busy = False
        self._looks_left = self._looks_between = 0

    def is_due(self, *, is_busy: bool) -> bool:
        """Whether much more is resident than after the last time, or all that was being done has ended."""
        has_ended, self._was_busy = self._was_busy and not is_busy, is_busy
        now = self._resident_bytes()
        if has_ended:
            self._kept = None  # what is left then is the least
            return self._try_later()
        if self._kept is None or now < self._kept:
            self._kept = now
        if now - self._kept <= KEPT_BYTES:
            return self._is_later()
        self._kept = now - KEPT_BYTES // 2  # so that what cannot be given back is not tried for at every look
        return self._try_later()

    def _try_later(self) -> bool:
        self._looks_left = self._looks_between = FIRST_LOOKS
        return True

    def _is_later(self) -> bool:
        if not self._looks_left:
            return False
        self._looks_left -= 1
        if self._looks_left:
            return False
        self._looks_between *= 2
        self._looks_left = self._looks_between if self._looks_between <= MOST_LOOKS else 0
        return True


@contextmanager
def settled_objects() -> Iterator[None]:
    """Leave all objects that there are out of garbage collection meanwhile, and look for garbage less often.

    For the time after everything is loaded. A full collection visits every object of every library while all threads
    stand still, which took 15 ms even without a model. Chunks and reports have no cycles: they go at once without it.
    """
    thresholds = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECT_EVERY)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)
        gc.unfreeze()  # so that libraries that look for leaks at the end find none


def settle_again() -> None:
    """Free what has been unloaded or was needed to load; within `settled_objects`, leave what has been loaded since out
    of collection too.
    """
    are_settled = gc.get_freeze_count() > 0
    gc.unfreeze()  # else rings of objects that nobody holds any more would stay
    gc.collect()
    give_back_freed_memory()
    if are_settled:
        gc.freeze()
