"""Writes files completely or not at all, even if the writer fails half way."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

_PREFIX = ".motiongen-"


@contextlib.contextmanager
def whole_file(path: Path | str) -> Iterator[Path]:
    """Yields a file of the same name in a temporary folder beside `path`; it replaces `path` at the end.

    If an exception is raised before that, `path` stays as it was. The target of a link is replaced, not the link. What
    is not a regular file, such as a pipe, is written to directly. Raises OSError, which names `path`.
    """
    target = Path(path).resolve()
    if target.exists() and not target.is_file():
        yield target
        return
    try:
        with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=target.parent) as folder:
            part = Path(folder) / target.name
            yield part
            if target.exists():
                shutil.copymode(target, part)
            part.replace(target)
    except OSError as error:
        if error.filename is None or str(error.filename).startswith(str(target.parent / _PREFIX)):
            error.filename, error.filename2 = str(path), None  # hide the temporary folder
        raise
