"""The labels table: one row of CSV for each clip."""

from __future__ import annotations

import csv
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
    """What the table says of a clip. texts: English descriptions; rest_group and flags may be empty."""

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
    """Read a labels table. Columns it must have: id, file, content, style, texts (parted by |), split.

    Raises LabelsError.
    """
    labels: list[Label] = []
    seen: set[str] = set()
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            missing = [column for column in _REQUIRED if column not in (reader.fieldnames or ())]
            if missing:
                raise LabelsError(f"{path}: columns are missing: {', '.join(missing)}; needed: {', '.join(_REQUIRED)}")
            for row in reader:
                label = _label(row, f"{path}, line {reader.line_num}")
                if label.id in seen:
                    raise LabelsError(f"{path}, line {reader.line_num}: a second row with id {label.id!r}")
                seen.add(label.id)
                labels.append(label)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LabelsError(f"{path}: cannot be read: {error}") from error
    if not labels:
        raise LabelsError(f"{path}: no rows")
    return tuple(labels)


def _label(row: dict[str, str | None], place: str) -> Label:
    cells = {column: (row.get(column) or "").strip() for column in _REQUIRED + _OPTIONAL}
    for column in _REQUIRED:
        if not cells[column]:
            raise LabelsError(f"{place}: column {column} is empty")
    if not cells["texts"].strip("| "):
        raise LabelsError(f"{place}: column texts has no text, only bars that part texts")
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
