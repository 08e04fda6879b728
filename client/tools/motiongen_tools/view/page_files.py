"""Where the page and three.js are, and what a browser may load."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path

from motiongen_client.errors import MotiongenError

PAGE = Path(__file__).with_name("page")
_THREE = PAGE / "node_modules" / "three"
_MODULE = Path("build") / "three.module.js"
_INLINE = re.compile(r"<script type=\"importmap\">(?P<text>.*?)</script>", re.DOTALL)


class ThreeMissing(MotiongenError):
    """three.js, which the page draws with, was not found."""

    def __init__(self, folder: Path) -> None:
        wanted = json.loads((PAGE / "package.json").read_text())["dependencies"]["three"]
        super().__init__(
            f"the page draws with three.js, which is not in {folder}: run `make viewer` (it needs npm), or unpack the "
            f"npm package three {wanted} somewhere and give --three FOLDER"
        )


def three_folder(given: Path | None = None) -> Path:
    """The folder of the npm package three. Raises ThreeMissing."""
    folder = _THREE if given is None else given
    if not (folder / _MODULE).is_file():
        raise ThreeMissing(folder)
    return folder


def content_policy() -> str:
    """The Content-Security-Policy: only our own scripts and styles, and the import map of the page."""
    found = _INLINE.search((PAGE / "index.html").read_text(encoding="utf-8"))
    digest = base64.b64encode(hashlib.sha256(found["text"].encode() if found else b"").digest()).decode()
    return (
        f"default-src 'none'; script-src 'self' 'sha256-{digest}'; style-src 'self'; img-src 'self' data: blob:; "
        "connect-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
