"""Files that are there whole or not at all, whatever ends the one who writes them."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

_PREFIX = ".motiongen-"


@contextlib.contextmanager
def whole_file(path: Path | str) -> Iterator[Path]:
    """A file of the same name to write to, in a folder of its own beside; it takes the place of `path` at the end.

    Where something is raised meanwhile, what was at `path` stays as it was. A link goes on pointing where it does, and
    what is no file, such as a pipe, is written as it is. Raises OSError, which names `path`.
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
            error.filename, error.filename2 = str(path), None  # nobody else knows of the folder beside
        raise
