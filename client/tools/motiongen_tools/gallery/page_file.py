"""The page of a gallery: a single file that contains its style, its program and all takes."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any

from motiongen_tools.whole_file import whole_file

PAGE = Path(__file__).with_name("page")


@dataclass
class Gallery:
    """columns: models or step counts, side by side. parts: title -> rows, each with a title and one take per column."""

    title: str
    columns: list[str]
    parts: dict[str, dict[str, list[dict[str, Any] | None]]] = field(default_factory=dict)

    def add(self, part: str, row: str, column: int, shown: dict[str, Any]) -> None:
        """Add a take."""
        rows = self.parts.setdefault(part, {})
        rows.setdefault(row, [None] * len(self.columns))[column] = shown


def write_gallery(path: Path, gallery: Gallery, made_at: datetime | None = None) -> None:
    """Write the page. made_at: the time shown on it, by default now."""
    made = (made_at or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC")
    parts = [
        {"title": part, "rows": [{"title": row, "takes": takes} for row, takes in rows.items()]}
        for part, rows in gallery.parts.items()
    ]
    told = {"columns": gallery.columns, "parts": parts}
    data = json.dumps(told, separators=(",", ":"), ensure_ascii=True).replace("<", "\\u003c")  # no text ends the script
    filled = {
        "{title}": escape(gallery.title),
        "{heading}": escape(gallery.title),
        "{made}": escape(made),
        "{style}": _text("gallery.css"),
        "{program}": _text("gallery.js"),
        "{data}": data,
    }
    page = _text("gallery.html")
    for name, text in filled.items():
        head, mark, tail = page.partition(name)
        assert mark, f"the page has no place for {name}"
        page = head + text + tail
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        part.write_text(page, encoding="utf-8")


def _text(name: str) -> str:
    return (PAGE / name).read_text(encoding="utf-8")
