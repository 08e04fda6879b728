"""The labels table: a CSV file with one row per clip."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from motiongen_ardy.data.validation import SEPARATOR

SPLITS = ("train", "test", "test_unseen")
_REQUIRED = ("id", "file", "content", "style", "texts", "split")
_OPTIONAL = ("dataset", "fps", "rest_group", "flags")


class LabelsError(ValueError):
    """Raised for a labels table that cannot be used. The message names the file and the line."""


@dataclass(frozen=True)
class Label:
    """One row of the table. texts: English descriptions; rest_group and flags may be empty."""

    id: str
    dataset: str
    file: str
    content: str
    style: str
    texts: tuple[str, ...]
    split: str
    rest_group: str
    flags: frozenset[str]


def read_labels(path: Path) -> tuple[Label, ...]:
    """Read a labels table. Required columns: id, file, content, style, texts (separated by |), split.

    Raises LabelsError.
    """
    labels: list[Label] = []
    ids: set[str] = set()
    files: dict[str, str] = {}
    line = 1
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            # Strict: otherwise, a quotation mark that is never closed would swallow all rows after it.
            reader = csv.DictReader(stream, strict=True)
            _check_header(path, reader.fieldnames or ())
            for row in reader:
                line = reader.line_num
                label = _label(row, f"{path}, line {line}")
                if label.id in ids:
                    raise LabelsError(f"{path}, line {line}: a second row with id {label.id!r}")
                ids.add(label.id)
                other = files.setdefault(file_key(label.file), label.id)
                if other != label.id:
                    raise LabelsError(
                        f"{path}, line {line}: {label.id!r} has the file of {other!r}, {label.file}; a file has one"
                        " row, with all of its texts, or training would see what is kept for the test"
                    )
                labels.append(label)
    except csv.Error as error:
        raise LabelsError(
            f"{path}, after line {line}: cannot be read: {error}; a cell in quotation marks ends with one, and has"
            " those within it twice"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise LabelsError(f"{path}: cannot be read: {error}; give a CSV table in UTF-8") from error
    if not labels:
        raise LabelsError(f"{path}: no rows")
    return tuple(labels)


def file_key(file: str) -> str:
    """A key that is the same for all spellings of a file's path."""
    return os.path.normpath(file)


def _check_header(path: Path, columns: Sequence[str]) -> None:
    missing = [column for column in _REQUIRED if column not in columns]
    if missing:
        raise LabelsError(f"{path}: columns are missing: {', '.join(missing)}; needed: {', '.join(_REQUIRED)}")
    twice = sorted(column for column in _REQUIRED + _OPTIONAL if list(columns).count(column) > 1)
    if twice:
        raise LabelsError(f"{path}: columns are there twice: {', '.join(twice)}; leave one of each")


def _label(row: Mapping[str | None, str | list[str] | None], place: str) -> Label:
    if beyond := row.get(None):
        raise LabelsError(
            f"{place}: {len(beyond)} cells more than the header has columns, the first {beyond[0]!r}; a cell with a"
            " comma is written in quotation marks"
        )
    cells = {column: str(row.get(column) or "").strip() for column in _REQUIRED + _OPTIONAL}
    for column in _REQUIRED:
        if not cells[column]:
            raise LabelsError(f"{place}: column {column} is empty")
    if not cells["texts"].strip("| "):
        raise LabelsError(f"{place}: column texts has no text, only bars that part texts")
    if "\0" in cells["file"]:
        raise LabelsError(f"{place}: column file has a character with the number 0, which no path has")
    if SEPARATOR in cells["id"]:
        raise LabelsError(f"{place}: id {cells['id']!r} has a {SEPARATOR}, which joins ids; write another character")
    if cells["split"] not in SPLITS:
        raise LabelsError(f"{place}: unknown split {cells['split']!r}; splits are {', '.join(SPLITS)}")
    return Label(
        id=cells["id"],
        dataset=cells["dataset"],
        file=cells["file"],
        content=cells["content"],
        style=cells["style"],
        texts=tuple(text.strip() for text in cells["texts"].split("|") if text.strip()),
        split=cells["split"],
        rest_group=cells["rest_group"],
        flags=frozenset(cells["flags"].replace(";", " ").replace("|", " ").split()),
    )
