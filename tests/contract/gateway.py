"""A server with two engine processes and fake runners: `python -m tests.contract.gateway`. Prints its address."""

from __future__ import annotations

import asyncio
import sys
from functools import partial

from motiongen_server.app import Application
from motiongen_server.config import ServerConfig
from motiongen_server.engine.ports import Deliver
from motiongen_server.engine.types import ModelFacts
from motiongen_server.engine_process.pool import EnginePool, start_engine_processes
from motiongen_server.ops.metrics import Metrics
from motiongen_server.run import stop_on_signals
from motiongen_server.text.ports import TextEncoder
from tests.contract.local import LengthEncoder
from tests.server.engine_process.audience import command


def start_engines(config: ServerConfig, deliver: Deliver, metrics: Metrics) -> EnginePool:
    pool = start_engine_processes(config, deliver, metrics, command("nothing"))

    def load_text(facts: ModelFacts) -> TextEncoder:
        return LengthEncoder()

    pool.load_text = load_text  # type: ignore[method-assign]
    return pool


async def serve() -> int:
    """Serve until SIGTERM. Returns the exit code."""
    settings = partial(ServerConfig, port=0, ops_port=0, drain_wait_s=0, drain_grace_s=0, playback_rate=1000)
    application = Application(
        settings(model="fake", devices="cpu:2", snapshot_store="none", text_guidance=2.0, constraint_guidance=2.0),
        start_engines,
    )
    stop_on_signals(application)
    await application.start()
    print(f"127.0.0.1:{application.grpc_port}", flush=True)
    await application.serve()
    return await application.drain()


if __name__ == "__main__":
    sys.exit(asyncio.run(serve()))
