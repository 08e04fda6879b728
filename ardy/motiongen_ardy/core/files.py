"""Files that are there whole, or as they were before, whenever their writer is ended."""

from __future__ import annotations

import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Where to write what shall be at `path`: a file of its name beside it, which takes its place once it is written.

    Where something is raised meanwhile, what was at `path` stays as it was. Each writer has a folder of its own for
    it, so two at once leave the file of one of them. A link goes on pointing where it does, a file keeps its mode, a
    new one has the usual one, and what is no file, such as a pipe, stays what it is and is given everything at the end.
    Raises OSError.
    """
    try:
        is_file = stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        is_file = True  # it will be one
    if not is_file:
        # By the name that was given: a shell's pipe, /dev/fd/63, resolves to no name that could be opened. And opened
        # here: a library that replaces what it is told to write would put a file in the place of /dev/null.
        with tempfile.TemporaryDirectory(prefix="motiongen-") as folder:
            partial = Path(folder) / path.name
            yield partial
            with partial.open("rb") as source, path.open("wb") as sink:
                shutil.copyfileobj(source, sink)
        return
    target = path.resolve()
    try:
        beside = tempfile.TemporaryDirectory(prefix=".motiongen-", dir=target.parent)
    except OSError as error:  # told by the name that was given
        raise OSError(error.errno, error.strerror, str(path)) from None
    with beside as folder:
        partial = Path(folder) / target.name
        partial.touch()
        usual = partial.stat().st_mode
        partial.unlink()
        yield partial
        # Of a new one, too: what libraries write, such as that of safetensors, is for their user's eyes alone.
        mode = target.stat().st_mode if target.exists() else usual
        if mode != partial.stat().st_mode:  # there are file systems that know of none
            partial.chmod(stat.S_IMODE(mode))
        partial.replace(target)
