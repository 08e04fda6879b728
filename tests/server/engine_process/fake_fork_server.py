"""A fork server of processes that load nothing: `python -m tests.server.engine_process.fake_fork_server`.

A forked process writes the names and values of its environment to the file `environment` in its folder. Then it ends
with the exit code in the file `code` there; without that file, it ends when its standard input does.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from pathlib import Path

from motiongen_server.engine_process.fork_server import ForkServer


def run(folder: Path) -> int:
    code = folder / "code"
    if code.exists():
        return int(code.read_text(encoding="ascii"))
    written = folder / "environment.part"
    written.write_text(json.dumps(dict(os.environ)), encoding="utf-8")
    written.rename(folder / "environment")
    while os.read(sys.stdin.fileno(), 1):
        pass
    return 0


if __name__ == "__main__":
    ForkServer(socket.socket(fileno=os.dup(sys.stdin.fileno())), run).serve()
