"""How the process manages its memory: what it keeps, what it gives back, and how often it collects garbage."""

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
"""The largest single block that is kept; glibc accepts no more."""
FIRST_LOOKS, MOST_LOOKS = 8, 128
"""Calls of `FreedMemory.is_due` from one attempt to give back memory to the next: the first number after the first
attempt, then twice as many after each, up to the second number."""
COLLECT_EVERY = (50_000, 10, 10)
"""Thresholds of Python's garbage collector: new objects still alive, then collections of the younger generations.
Python's default is 700, 10, 10."""


def keep_freed_memory() -> bool:
    """Keep freed memory for the next message instead of giving it back to the operating system. True if that succeeds.

    Messages with frames and tensors have hundreds of kilobytes each. By default glibc gives that memory back when it is
    freed, and then gets it again page by page: half of the cost of sending frames.
    """
    return _set_malloc(_TRIM_THRESHOLD, KEPT_BYTES) and _set_malloc(_MMAP_THRESHOLD, LARGEST_KEPT_BYTES)


def use_one_arena() -> bool:
    """Make all threads allocate from the main arena; to be called before threads start. True if that succeeds.

    malloc_trim gives back only the end of the main arena. An arena of another thread stays as large as its highest peak
    so far, so it keeps growing, if ever more slowly. For processes in which one thread does the work.
    """
    return _set_malloc(_ARENA_MAX, 1)


def _set_malloc(parameter: int, value: int) -> bool:
    try:
        return bool(ctypes.CDLL(None).mallopt(parameter, value))
    except (AttributeError, OSError, TypeError):  # another C library
        return False


def give_back_freed_memory() -> bool:
    """Give free memory back to the operating system, once. True if there was any to give back.

    For the end of a peak, such as loading and measuring a model, which takes more memory than serving it ever does.
    """
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library
        return False
    return bool(trim(0))


def free_garbage() -> None:
    """Free unreachable cycles of objects. For moments without work.

    Within `settled_objects` collections are so rare that the cycles of thousands of sessions add up. Settled objects
    are not visited, so it takes a few milliseconds.
    """
    gc.collect()


def resident_bytes(pid: int) -> int:
    """Resident memory of a process, including what it shares with others; 0 if unknown."""
    try:
        return resource.getpagesize() * int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError, ValueError):  # it has just ended, or this system has no /proc
        return 0


class FreedMemory:
    """Decides when to give memory back: after a peak, and when all work has ended.

    Memory that normal operation uses is kept. Sessions of different lengths leave free pieces between objects that live
    longer, more and more of them in a day. The memory of a peak may still be in use when the peak is noticed, for
    example by calls that wait for the event loop: hence a few more attempts follow, at growing intervals.
    """

    def __init__(self, resident_bytes_of_process: Callable[[], int] | None = None) -> None:
        self._resident_bytes = resident_bytes_of_process or (lambda: resident_bytes(os.getpid()))
        self._kept: int | None = None
        self._was_busy = False
        self._looks_left = self._looks_between = 0

    def is_due(self, *, is_busy: bool) -> bool:
        """Whether resident memory has grown much since the last time, all work has just ended, or an attempt is due."""
        has_ended, self._was_busy = self._was_busy and not is_busy, is_busy
        now = self._resident_bytes()
        if has_ended:
            self._kept = None  # the next call measures what is left
            return self._try_later()
        if self._kept is None or now < self._kept:
            self._kept = now
        if now - self._kept <= KEPT_BYTES:
            return self._is_later()
        self._kept = now - KEPT_BYTES // 2  # else memory that cannot be given back would be due in every call
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
    """Within it, exclude all objects that already exist from garbage collection, and collect less often.

    For the time after everything is loaded. A full collection visits every object of every library while all threads
    stand still, which took 15 ms even without a model. Chunks and reports have no cycles, so they are freed without it.
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
    """Free what was unloaded or needed only for loading. Within `settled_objects`, exclude what has been loaded since
    from collection, too.
    """
    are_settled = gc.get_freeze_count() > 0
    gc.unfreeze()  # else unreachable cycles among the settled objects would stay
    gc.collect()
    give_back_freed_memory()
    if are_settled:
        gc.freeze()
