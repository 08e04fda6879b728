"""Writes files atomically: whenever the writer ends, the file is either complete or as it was before."""

from __future__ import annotations

import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A temporary path to write to; on success, the file written there replaces the one at `path`.

    If an exception is raised meanwhile, what was at `path` stays unchanged. Each writer has a temporary folder of its
    own, so of two concurrent writers one wins. A symbolic link keeps its target, an existing file keeps its mode, a new
    one gets the usual mode, and anything that is not a regular file, such as a pipe, receives the whole content at the
    end. Raises OSError.
    """
    try:
        is_file = stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        is_file = True  # it will be one
    if not is_file:
        # Opened under the name that was given: a shell's pipe, /dev/fd/63, resolves to no name that could be opened.
        # And opened here: a library that replaces the file it is told to write would replace /dev/null by a regular
        # file.
        with tempfile.TemporaryDirectory(prefix="motiongen-") as folder:
            partial = Path(folder) / path.name
            yield partial
            with partial.open("rb") as source, path.open("wb") as sink:
                shutil.copyfileobj(source, sink)
        return
    target = path.resolve()
    try:
        beside = tempfile.TemporaryDirectory(prefix=".motiongen-", dir=target.parent)
    except OSError as error:  # report the name that was given
        raise OSError(error.errno, error.strerror, str(path)) from None
    with beside as folder:
        partial = Path(folder) / target.name
        partial.touch()
        usual = partial.stat().st_mode
        partial.unlink()
        yield partial
        # Of new files too: some libraries, such as safetensors, create files that only their owner can read.
        mode = target.stat().st_mode if target.exists() else usual
        if mode != partial.stat().st_mode:  # some file systems have no modes
            partial.chmod(stat.S_IMODE(mode))
        partial.replace(target)
