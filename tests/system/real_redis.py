"""A real Redis, or Valkey, for the duration of a test: `apt-get install redis-server`."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import redis

from tests.waiting import until


def url_in(folder: Path) -> str:
    """The URL of a Redis that is started in this folder."""
    return f"unix://{folder / 'redis.sock'}"


def start_redis(folder: Path, *more: str) -> subprocess.Popen[bytes]:
    """Start it, and return once it answers. It saves nothing to disk. Raises RuntimeError if it does not start."""
    program = shutil.which("redis-server") or shutil.which("valkey-server")
    assert program, "neither redis-server nor valkey-server is installed; apt-get install redis-server"
    socket = folder / "redis.sock"
    arguments = ["--port", "0", "--unixsocket", str(socket), "--save", "", "--dir", str(folder), *more]
    # Tried twice: an outgoing connection of another process may hold its port for a moment.
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
