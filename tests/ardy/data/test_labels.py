"""The table of labels: each row is read in full or refused; nothing is lost silently."""

from __future__ import annotations

from pathlib import Path

import pytest

from motiongen_ardy.data.labels import LabelsError, read_labels
from tests.ardy.data.captures import HEADER, write_table

GOOD = "a,a.bvh,walk,normal,train,he walks"


def test_a_text_with_commas_and_quotes_is_read_in_full(tmp_path: Path) -> None:
    row = 'b,b.bvh,walk,normal,train,"he walks, then says ""hello""|she walks"'
    _, label = read_labels(write_table(tmp_path / "labels.csv", GOOD, row))
    assert label.texts == ('he walks, then says "hello"', "she walks")


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("b,b.bvh,walk,normal,train,he walks, and waves", "line 3: 1 cells more than the header has columns"),
        ('b,b.bvh,walk,normal,train,"he walks', "cannot be read: unexpected end of data; a cell in quotation marks"),
        ('b,b.bvh,walk,normal,train,"he" walks', "after line 2: cannot be read: .* a cell in quotation marks"),
        ("b,./a.bvh,walk,normal,test,he walks", "line 3: 'b' has the file of 'a', ./a.bvh; a file has one row"),
        ("b,b\0.bvh,walk,normal,train,he walks", "line 3: column file has a character with the number 0"),
        ("b,x/../a.bvh,walk,normal,train,he walks", "'b' has the file of 'a'"),
    ],
)
def test_malformed_rows_and_duplicate_files_are_refused(row: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(LabelsError, match=said):
        read_labels(write_table(tmp_path / "labels.csv", GOOD, row))


def test_an_unclosed_quotation_mark_does_not_swallow_later_rows(tmp_path: Path) -> None:
    rows = (GOOD, 'b,b.bvh,walk,normal,train,"he walks', "c,c.bvh,walk,normal,train,she walks")
    with pytest.raises(LabelsError, match="after line 2"):
        read_labels(write_table(tmp_path / "labels.csv", *rows))


def test_a_duplicate_column_is_refused(tmp_path: Path) -> None:
    path = write_table(tmp_path / "labels.csv", GOOD + ",she walks")
    path.write_text(path.read_text().replace(HEADER, HEADER + ",texts"))
    with pytest.raises(LabelsError, match="columns are there twice: texts"):
        read_labels(path)
