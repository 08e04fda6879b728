"""Watched: the content of files, read again when one of them has changed."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

_log = logging.getLogger(__name__)

RETRY_S = 1.0
"""Files that could not be read are tried again after this time: they may name other files, which may exist by then."""

T = TypeVar("T")
_Signature = tuple[tuple[int, int, int], ...]


class Watched(Generic[T]):
    """The value that `read` makes of files. Used from any thread.

    Files may be rewritten, or replaced one after the other: if reading fails, for whatever reason, that is logged, and
    the last value stays in use until reading succeeds.
    """

    def __init__(self, what: str, paths: Sequence[str], read: Callable[[], T]) -> None:
        """what: names the files in the log. Raises what `read` raises, which must be ValueError or OSError."""
        self._what = what
        self._paths = paths
        self._read = read
        self._lock = threading.Lock()
        self._seen: _Signature | None = None
        self._failed: _Signature | None = None
        self._retry_at = 0.0
        self._told = ""
        before = self._signature()
        self.value = read()
        self._seen = before

    def look(self) -> bool:
        """Read the files again if one of them has changed; returns whether `value` was replaced."""
        with self._lock:
            try:
                signature = self._signature()
                if signature == self._seen or (signature == self._failed and time.monotonic() < self._retry_at):
                    return False
                value = self._read()
                if self._signature() != signature:
                    return False  # a file changed while it was read: the next `look` reads it again
            except Exception as error:  # must not reach callers of `look`, which admit calls and watch all streams
                self._note_failure(error)
                return False
            self._seen, self._failed, self._told = signature, None, ""
            self.value = value
        _log.info("%s: read again", self._what)
        return True

    def _note_failure(self, error: Exception) -> None:
        try:
            failed = self._signature()
        except OSError:
            failed = ()
        self._retry_at = time.monotonic() + RETRY_S
        said = str(error) if isinstance(error, OSError | ValueError) else repr(error)
        if failed != self._failed or said != self._told:
            self._failed, self._told = failed, said
            _log.error("%s: cannot be read again, the last content stays in use: %s", self._what, said)

    def _signature(self) -> _Signature:
        seen = (os.stat(path) for path in self._paths)
        return tuple((each.st_mtime_ns, each.st_ino, each.st_size) for each in seen)
