"""The real server with engine processes that compute nothing: `python -m tests.bench.null_server --port 0 ...`.

Takes the server's own settings. With an encoder at `--text-encoder grpc:HOST:PORT` it uses the first numbers of each
vector, otherwise a prompt's length. Once ready it prints a JSON line with both ports and, by name, the operating
system's numbers of its threads, so that their CPU times can be told apart. SIGTERM ends it.
"""

from __future__ import annotations

import asyncio
import json
import sys
import threading
from collections.abc import Callable, Sequence

import numpy as np

from motiongen_ardy.text import Vectors
from motiongen_server.app import Application, MakeEngines
from motiongen_server.config import ServerConfig, parse_config
from motiongen_server.engine.ports import Deliver
from motiongen_server.engine.types import ModelFacts
from motiongen_server.engine_process.pool import EnginePool, start_engine_processes
from motiongen_server.ops.logs import configure_logs
from motiongen_server.ops.memory import keep_freed_memory, settled_objects
from motiongen_server.ops.metrics import Metrics
from motiongen_server.run import leave, stop_on_signals
from motiongen_server.text.encoder.client import RemoteEncoder
from motiongen_server.text.ports import TextEncoder
from tests.bench.null_runner import NullEncoder


class FirstNumbers:
    """An encoder service whose vectors are cut, for a model that takes shorter ones."""

    def __init__(self, address: str, width: int) -> None:
        self._remote = RemoteEncoder(address, 20.0)
        self._width = width

    @property
    def identity(self) -> str:
        return self._remote.identity

    def encode(self, texts: Sequence[str]) -> Vectors:
        return np.ascontiguousarray(self._remote.encode(texts)[:, : self._width])


def start_null_engines(
    config: ServerConfig, deliver: Deliver, metrics: Metrics, own_encoder: Callable[[], TextEncoder] = NullEncoder
) -> EnginePool:
    """own_encoder: makes the text encoder of this process."""
    pool = start_engine_processes(config, deliver, metrics, (sys.executable, "-m", "tests.bench.null_engine"))

    def load_text(facts: ModelFacts) -> TextEncoder:
        kind, _, address = config.text_encoder.partition(":")
        return FirstNumbers(address, facts.embedding_dim) if kind == "grpc" else own_encoder()

    pool.load_text = load_text  # type: ignore[method-assign]
    return pool


async def serve(config: ServerConfig, start: MakeEngines = start_null_engines) -> int:
    """Serve until SIGTERM. Returns the exit code."""
    application = Application(config, start)
    stop_on_signals(application)
    await application.start()
    threads = {thread.name: thread.native_id for thread in threading.enumerate()}
    print(
        json.dumps({"grpc_port": application.grpc_port, "ops_port": application.ops_port, "threads": threads}),
        flush=True,
    )
    with settled_objects():
        await application.serve()
        return await application.drain()


def main(start: MakeEngines = start_null_engines) -> None:
    """Serve with the settings of the command line, then end the process."""
    keep_freed_memory()
    config = parse_config(sys.argv[1:])
    configure_logs(config.log_level, config.log_format)
    leave(asyncio.run(serve(config, start)))


if __name__ == "__main__":
    main()
