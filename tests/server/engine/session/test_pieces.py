"""Pieces are the rows that they stand for, however they came, and hold no more memory than about that."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.session.pieces import Pieces


def memory_of(pieces: Pieces) -> int:
    """Bytes that the arrays keep, with those that they are views of."""
    owners = {id(owner): owner for array in pieces.arrays for owner in [array if array.base is None else array.base]}
    return sum(owner.nbytes for owner in owners.values())


changes = st.lists(
    st.tuples(st.sampled_from(["plus", "after", "below", "since"]), st.integers(0, 40)),
    max_size=30,
)


@given(changes, st.data())
def test_pieces_are_the_rows_they_stand_for(made: list[tuple[str, int]], data: st.DataObject) -> None:
    pieces, whole = Pieces.of(np.empty((0, 2), np.float32)), list[float]()
    views: list[tuple[np.ndarray, list[float]]] = []
    for number, (change, size) in enumerate(made):
        rows = np.full((size, 2), number, np.float32)
        at = min(size, len(whole))
        if change == "plus":
            pieces, whole = pieces.plus(rows), [*whole, *rows[:, 0].tolist()]
        elif change == "after":
            pieces, whole = pieces.after(rows), [*rows[:, 0].tolist(), *whole]
        elif change == "below":
            pieces, whole = pieces.below(at), whole[:at]
        else:
            pieces, whole = pieces.since(at), whole[at:]
        rows[:] = -1.0 if change == "plus" else number  # what was copied stays what it was
        begin = data.draw(st.integers(0, len(whole)))
        end = data.draw(st.integers(begin, len(whole)))
        views.append((pieces.between(begin, end), whole[begin:end]))
        assert pieces.count == len(whole)
        assert all(view.shape == (len(rows), 2) and view[:, 0].tolist() == rows for view, rows in views)


@given(changes)
def test_pieces_keep_about_the_memory_of_their_rows(made: list[tuple[str, int]]) -> None:
    pieces = Pieces.of(np.empty((0, 2), np.float32))
    for change, size in made:
        if change in ("plus", "after"):
            pieces = getattr(pieces, change)(np.zeros((size, 2), np.float32))
        else:
            pieces = getattr(pieces, change)(min(size, pieces.count))
        # An array is cut at either end, and once it is less than half of what it was it is copied.
        assert memory_of(pieces) <= 2 * 8 * pieces.count


def test_what_came_together_is_not_copied() -> None:
    pieces = Pieces.of(np.zeros((40, 3), np.float32)).plus(np.ones((40, 3), np.float32))
    assert np.shares_memory(pieces.between(10, 30), pieces.arrays[0])
    assert np.shares_memory(pieces.plus(np.ones((4, 3), np.float32)).between(50, 80), pieces.arrays[1])
    assert pieces.between(30, 50)[:, 0].tolist() == [0.0] * 10 + [1.0] * 10


def test_a_part_of_something_large_lets_go_of_it() -> None:
    decoded = np.zeros((128, 40, 3), np.float32)
    pieces = Pieces.of(np.empty((0, 3), np.float32)).plus(decoded[5])
    assert memory_of(pieces) == 40 * 12
    received = np.frombuffer(bytes(100 * 12), np.float32).reshape(100, 3)
    assert memory_of(Pieces.of(received).since(90)) == 10 * 12
