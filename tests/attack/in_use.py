"""Memory in use in every process of a server, to the byte: resident memory shows a leak only after thousands of cycles.

This file is copied as `sitecustomize` to where the server's processes find it, and lets each of them report the figure
on a socket. In these processes all Python objects come from malloc, which knows what is in use and keeps no freed
blocks for reuse.
"""

from __future__ import annotations

import ctypes
import gc
import os
import shutil
import socket
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FOLDER = "IN_USE_FOLDER"


class _Mallinfo(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_size_t)
        for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks",
                     "keepcost")
    ]  # fmt: skip


def bytes_in_use() -> int:
    """Bytes in use by this process, after dropping garbage and kernels. Call it when nothing is being computed."""
    if (kernels := sys.modules.get("motiongen_server.runner.kernels")) is not None:
        kernels.free_kernels()
    gc.collect()
    ask = ctypes.CDLL(None).mallinfo2
    ask.restype = _Mallinfo
    told = ask()
    return int(told.uordblks + told.hblkhd)


def _tell(folder: str) -> None:
    """Send the figure to every connection to this process's socket."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(f"{folder}/{os.getpid()}")
        listener.listen()
        while True:
            asking, _ = listener.accept()
            with asking:
                asking.sendall(str(bytes_in_use()).encode())


class InUse:
    """Asks the processes of a server that was started with this environment."""

    def __init__(self, folder: str) -> None:
        self._folder = folder
        self.environment = {
            FOLDER: folder,
            "PYTHONPATH": os.pathsep.join((folder, os.environ.get("PYTHONPATH", ""))),
            "PYTHONMALLOC": "malloc",
            "GLIBC_TUNABLES": "glibc.malloc.tcache_count=0",
        }

    def bytes_of(self, pid: int) -> int:
        """Bytes that a process has in use now."""
        with socket.socket(socket.AF_UNIX) as asking:
            asking.connect(f"{self._folder}/{pid}")
            return int(asking.makefile().read())


@contextmanager
def told() -> Iterator[InUse]:
    """InUse for a server that is started in this context. The folder's name is short, as paths of sockets must be."""
    folder = tempfile.mkdtemp(prefix="in-use-")
    try:
        shutil.copy(__file__, Path(folder) / "sitecustomize.py")
        yield InUse(folder)
    finally:
        shutil.rmtree(folder)


if __name__ == "sitecustomize" and FOLDER in os.environ:
    threading.Thread(target=_tell, args=(os.environ[FOLDER],), name="in-use", daemon=True).start()
