"""Pieces: rows one after another in the arrays that they came in, so that more are put after them without a copy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.types import Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """A new value for every change; arrays are never written to, so that views of an old one stay true.

    arrays: (T, W) float32 each, one at least. count: rows of all of them.
    """

    arrays: tuple[Float32Array, ...]
    count: int

    @classmethod
    def of(cls, rows: Float32Array) -> Pieces:
        """The rows of one array (T, W), which is kept as it is."""
        return cls((rows,), len(rows))

    def between(self, begin: int, end: int) -> Float32Array:
        """The rows from `begin` up to, not including, `end`: a view where they came together."""
        found: list[Float32Array] = []
        first = self.count
        for array in reversed(self.arrays):  # what is asked for lies near the end
            first -= len(array)
            if first < end:
                found.append(array[max(0, begin - first) : end - first])
                if first <= begin:
                    break
        if len(found) == 1:
            return found[0]
        return np.concatenate(found[::-1]) if found else self.arrays[0][:0]

    def plus(self, rows: Float32Array) -> Pieces:
        """With a copy of rows (T, W) after them: what they are part of may be far larger."""
        more = np.array(rows, np.float32)
        return Pieces((*self.arrays, more) if self.count else (more,), self.count + len(rows))

    def after(self, rows: Float32Array) -> Pieces:
        """With rows (T, W) before them, which are kept as they are."""
        return Pieces((rows, *self.arrays), self.count + len(rows))

    def below(self, end: int) -> Pieces:
        """The rows below `end`."""
        kept, count = list(self.arrays), self.count
        while len(kept) > 1 and count - len(kept[-1]) >= end:
            count -= len(kept.pop())
        if count > end:
            kept[-1] = _let_go(kept[-1][: len(kept[-1]) - (count - end)])
        return Pieces(tuple(kept), end)

    def since(self, begin: int) -> Pieces:
        """The rows from `begin` on."""
        first, passed = 0, 0
        while passed < len(self.arrays) - 1 and first + len(self.arrays[passed]) <= begin:
            first += len(self.arrays[passed])
            passed += 1
        rest = _let_go(self.arrays[passed][begin - first :]) if begin > first else self.arrays[passed]
        return Pieces((rest, *self.arrays[passed + 1 :]), self.count - begin)


def _let_go(part: Float32Array) -> Float32Array:
    """A copy of a view of less than half of an array, all of which it would keep; or of who knows what."""
    whole = part.base
    is_most = isinstance(whole, np.ndarray) and whole.base is None and 2 * part.nbytes >= whole.nbytes
    return part if whole is None or is_most else part.copy()
