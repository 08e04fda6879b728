"""The numbers of rows that are recorded beforehand: they cover every number of sequences."""

from __future__ import annotations

import pytest

from motiongen_ardy.model.packed.graphs import SIZES, filled_size, sizes_up_to


@pytest.mark.parametrize("passes", [1, 2, 3, 4])
@pytest.mark.parametrize("most", [1, 6, 64, 128])
def test_all_numbers_of_sequences_are_recorded(passes: int, most: int) -> None:
    sizes = sizes_up_to(most, passes)
    assert sizes == sorted(set(sizes))
    recorded = {filled_size(passes * size) for size in sizes}
    assert recorded == {filled_size(passes * rows) for rows in range(1, most + 1)}
    assert {filled_size(size) for size in sizes} == {filled_size(rows) for rows in range(1, most + 1)}


def test_with_one_pass_the_recorded_numbers_are_the_sizes() -> None:
    assert sizes_up_to(96) == [size for size in SIZES if size <= 96]
