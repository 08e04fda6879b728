"""The page of a gallery is one file, and its content is escaped."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

from motiongen_tools.gallery.animation import refused
from motiongen_tools.gallery.page_file import Gallery, write_gallery


def test_the_page_is_self_contained_and_escapes_its_content(tmp_path: Path) -> None:
    gallery = Gallery("a <model>", ["4 steps", "10 steps"])
    gallery.add("Presets", "walk", 1, refused("</script><script>alert(1)</script> {program}"))
    write_gallery(tmp_path / "new" / "gallery.html", gallery, datetime(2026, 1, 2, 3, 4, tzinfo=UTC))
    page = (tmp_path / "new" / "gallery.html").read_text(encoding="utf-8")
    assert "<title>a &lt;model&gt;: gallery</title>" in page
    assert "2026-01-02 03:04 UTC" in page
    assert page.count("</script>") == 2
    assert "{style}" not in page
    assert 'src="' not in page
    data = json.loads(page.partition('id="takes">')[2].partition("</script>")[0])
    assert data["columns"] == ["4 steps", "10 steps"]
    (row,) = data["parts"][0]["rows"]
    assert row["takes"][0] is None
    assert row["takes"][1]["detail"] == "</script><script>alert(1)</script> {program}"
