"""The real server with a runner that computes nothing: `python -m tests.bench.null_server --port 0 ...`.

Takes the server's own settings. Once ready it prints a JSON line with both ports and, by name, the operating system's
numbers of its threads, so that their processor time can be told apart. SIGTERM ends it.
"""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import threading

from motiongen_server.app import Application, Loaded
from motiongen_server.config import ServerConfig, parse_config
from motiongen_server.ops.memory import keep_freed_memory, settled_objects
from tests.bench.null_runner import STEP_S, NullEncoder, NullRunner


def load_nothing(config: ServerConfig) -> Loaded:
    del config
    return Loaded(NullRunner(STEP_S), NullEncoder(), "none", threads=1)


async def serve(config: ServerConfig) -> int:
    """Until SIGTERM. Returns the exit code."""
    application = Application(config, load_nothing, (sys.executable, "-m", "tests.bench.null_engine"))
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, application.ask_to_stop)
    await application.start()
    threads = {thread.name: thread.native_id for thread in threading.enumerate()}
    print(json.dumps({"grpc_port": application.grpc_port, "threads": threads}), flush=True)
    with settled_objects():
        await application.serve()
        return await application.drain()


if __name__ == "__main__":
    keep_freed_memory()
    sys.exit(asyncio.run(serve(parse_config(sys.argv[1:]))))
