"""A real Redis, or Valkey, for as long as a test takes: `apt-get install redis-server`."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import redis

from tests.waiting import until


def url_in(folder: Path) -> str:
    """Of a Redis that is started there."""
    return f"unix://{folder / 'redis.sock'}"


def start_redis(folder: Path, *more: str) -> subprocess.Popen[bytes]:
    """Return once it answers. Nothing of it is kept on the disk. Raises RuntimeError where it does not start."""
    program = shutil.which("redis-server") or shutil.which("valkey-server")
    assert program, "neither redis-server nor valkey-server is installed; apt-get install redis-server"
    socket = folder / "redis.sock"
    arguments = ["--port", "0", "--unixsocket", str(socket), "--save", "", "--dir", str(folder), *more]
    # Somebody else may have got its port, for a moment: every connection takes one.
    for _ in range(2):
        process = subprocess.Popen([program, *arguments], stdout=subprocess.DEVNULL)
        if until(lambda started=process: _answers(socket) or started.poll() is not None) and process.poll() is None:  # type: ignore[misc]
            return process
    raise RuntimeError(f"{program} {' '.join(more)} ended with {process.returncode}, twice")


def _answers(socket: Path) -> bool:
    client = redis.Redis(unix_socket_path=str(socket))
    try:
        return bool(client.ping())
    except redis.RedisError:
        return False
    finally:
        client.close()
