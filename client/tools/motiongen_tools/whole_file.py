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
    given = Path(path)
    target = given.resolve()
    try:
        if given.exists() and not given.is_file():
            yield given
            return
        with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=target.parent) as folder:
            part = Path(folder) / given.name  # not the target's: a link to a file of another name tells the format
            yield part
            if target.exists():
                shutil.copymode(target, part)
            part.replace(target)
    except OSError as error:
        is_hidden = str(error.filename).startswith(str(target.parent / _PREFIX))
        if error.errno is not None and (error.filename is None or is_hidden):
            # another error: in this one, a second name that is set to None would be printed
            raise OSError(error.errno, error.strerror, str(path)) from None  # hides the temporary folder
        raise
