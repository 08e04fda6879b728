"""BatchRetry: calls the runner for many jobs at once, for fewer if memory runs out, for each alone if it fails."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

from motiongen_server.engine.ports import DeviceLost, OutOfMemory

_log = logging.getLogger(__name__)
_Item = TypeVar("_Item")
_Answer = TypeVar("_Answer")

# After this many full calls without trouble, a call may be an eighth larger again.
_CALM_CALLS = 64


class CallTime(NamedTuple):
    """What a call took: seconds, and seconds of processor time; both are the same if processor time is not counted."""

    seconds: float
    spent_s: float


class BatchRetry(Generic[_Item, _Answer]):
    """One kind of call. most: items in a call; it halves when memory runs out, and grows back slowly.

    job_id_of: the job of an item. failed: called for every job that fails even alone, with the error.
    """

    def __init__(
        self,
        call: Callable[[Sequence[_Item]], list[_Answer]],
        job_id_of: Callable[[_Item], int],
        failed: Callable[[int, Exception], None],
        observe: Callable[[Sequence[_Item], CallTime], None],
        read_clocks: Callable[[], CallTime],
        most: int,
    ) -> None:
        """observe: called after every successful call with its items and its time by `read_clocks`."""
        self._call = call
        self._job_id_of = job_id_of
        self._failed = failed
        self._observe = observe
        self._read_clocks = read_clocks
        self._largest = most
        self._calm = 0
        self.most = most
        self.faults = 0
        self.splits = 0

    def __call__(self, items: Sequence[_Item]) -> list[_Answer]:
        """The answers for all items that succeeded, in their order. Raises DeviceLost."""
        answers: list[_Answer] = []
        done = 0
        while done < len(items):
            part = items[done : done + self.most]
            try:
                answers += self._timed(part)
            except OutOfMemory as error:
                if len(part) > 1:
                    self._shrink(len(part))
                    continue
                self._fail(part[0], error)
            except DeviceLost:
                raise
            except Exception:
                self.faults += 1
                _log.exception("the runner failed for %d jobs; trying each alone", len(part))
                answers += self._each_alone(part)
            else:
                self._grow(len(part))
            done += len(part)
        return answers

    def _timed(self, part: Sequence[_Item]) -> list[_Answer]:
        begun = self._read_clocks()
        answers = self._call(part)
        ended = self._read_clocks()
        self._observe(part, CallTime(ended.seconds - begun.seconds, ended.spent_s - begun.spent_s))
        return answers

    def _each_alone(self, part: Sequence[_Item]) -> list[_Answer]:
        answers: list[_Answer] = []
        for item in part:
            try:
                answers += self._timed([item])
            except DeviceLost:
                raise
            except Exception as error:
                self._fail(item, error)
        return answers

    def _fail(self, item: _Item, error: Exception) -> None:
        self.faults += 1
        _log.error("the runner failed for job %d alone", self._job_id_of(item), exc_info=error)
        self._failed(self._job_id_of(item), error)

    def _shrink(self, num_items: int) -> None:
        self.most = num_items // 2
        self.splits += 1
        self._calm = 0
        _log.warning("out of memory with %d jobs in a call; from now on %d", num_items, self.most)

    def _grow(self, num_items: int) -> None:
        """Allow slightly larger calls after many that were as large as allowed."""
        if self.most >= self._largest or num_items < self.most:
            return
        self._calm += 1
        if self._calm >= _CALM_CALLS:
            self._calm = 0
            self.most = min(self._largest, self.most + max(1, self.most // 8))
