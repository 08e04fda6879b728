"""Servers to compare with: `python -m tests.bench.stand_ins service --port 0 ...` and `... grpc RESPONSE_BYTES`.

service: the real service, on an engine that answers every report with frames and decides nothing. grpc: gRPC alone,
which answers every message with RESPONSE_BYTES bytes. Both print the same JSON line as the null server.
"""

from __future__ import annotations

import asyncio
import json
import sys
import threading
import time
from typing import Any

import grpc.aio
import numpy as np

from motiongen_server.config import ServerConfig, parse_config
from motiongen_server.engine.mailbox import Mailbox
from motiongen_server.engine.ports import Deliver
from motiongen_server.engine.types import (
    Chunk,
    Close,
    Closed,
    Code,
    Event,
    EventRefused,
    Float32Array,
    Open,
    Outcome,
    Output,
    PlanCause,
    PlanNotice,
    Playhead,
    Priority,
    SessionKey,
)
from motiongen_server.models.factory import make_catalog, make_limits
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.ops.memory import keep_freed_memory, settled_objects
from motiongen_server.rpc.handlers import SERVICE_NAME, add_methods
from motiongen_server.rpc.service import MotionService
from motiongen_server.text.prompts import PromptEncoder
from tests.bench.null_runner import FACTS, STEP_S, NullEncoder

LOOKAHEAD = 40


class NullEngine:
    """Answers each open or report with one chunk up to the look-ahead, and a plan for every horizon."""

    num_sessions = 0
    failure: BaseException | None = None

    def __init__(self) -> None:
        self._mailbox = Mailbox(max_pending_events=64)
        self._sent_to: dict[SessionKey, int] = {}
        self._rows: dict[SessionKey, Float32Array] = {}  # one each, or the CPU's cache would hold them all
        self.deliver: Deliver = lambda outputs: None

    def submit(self, event: Event) -> Outcome | None:
        self._mailbox.put(event)
        return None

    def refusal_of(self, priority: Priority, denoise_steps: int) -> EventRefused | None:
        return None

    def start(self) -> None:
        threading.Thread(target=self._run, name="engine", daemon=True).start()

    def _run(self) -> None:
        while True:
            self._mailbox.wait(1.0)
            time.sleep(STEP_S)  # as with a model, what arrives during a step is answered together
            if outputs := self.answers():
                self.deliver(outputs)

    def answers(self) -> list[Output]:
        """The answers to everything that has arrived."""
        outputs: list[Output] = []
        for event in self._mailbox.take_all():
            self._answer(event, outputs)
        return outputs

    def _answer(self, event: Event, outputs: list[Output]) -> None:
        key = event.session
        if isinstance(event, Close):
            del self._sent_to[key], self._rows[key]
            outputs.append(Closed(key, event.reason, Code.OK, "", 0, 0))
            return
        if isinstance(event, Open):
            self._sent_to[key], self._rows[key] = 0, np.zeros((LOOKAHEAD, FACTS.row_width), np.float32)
        first, end = self._sent_to[key], LOOKAHEAD + (event.frame if isinstance(event, Playhead) else 0)
        if end <= first:
            return
        plan = end // FACTS.horizon
        if plan > first // FACTS.horizon:
            outputs.append(PlanNotice(key, plan, first, PlanCause.CONTINUE, ()))
        outputs.append(Chunk(key, plan, first, self._rows[key][: end - first], end - LOOKAHEAD))
        self._sent_to[key] = end


def null_models(config: ServerConfig, engine: NullEngine) -> ModelRegistry:
    """A registry with the null engine as its only model."""
    prompts = PromptEncoder(NullEncoder(), config.prompt_cache)
    catalog = make_catalog(config, FACTS, "none", prompts.identity)
    return ModelRegistry(LoadedModel("null", engine, prompts, catalog))  # type: ignore[arg-type]


async def serve_service(config: ServerConfig) -> None:
    engine = NullEngine()
    service = MotionService(null_models(config, engine), config.flush_ms / 1000, limits=make_limits(config))
    engine.deliver = service.deliver
    engine.start()
    server = grpc.aio.server(options=[("grpc.max_send_message_length", 8 << 20)])
    add_methods(service, server)
    await serve(server)


async def serve_grpc(response_bytes: int) -> None:
    response = bytes(response_bytes)

    async def answer(request_iterator: Any, context: Any) -> None:
        while await context.read() is not grpc.aio.EOF:
            await context.write(response)

    server = grpc.aio.server(options=[("grpc.max_send_message_length", 8 << 20)])
    handlers = {"StreamMotion": grpc.stream_stream_rpc_method_handler(answer)}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE_NAME, handlers),))
    await serve(server)


async def serve(server: grpc.aio.Server) -> None:
    """Serve until the process is ended."""
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    threads = {thread.name: thread.native_id for thread in threading.enumerate()}
    print(json.dumps({"grpc_port": port, "threads": threads}), flush=True)
    with settled_objects():
        await server.wait_for_termination()


if __name__ == "__main__":
    keep_freed_memory()
    kind, *rest = sys.argv[1:]
    asyncio.run(serve_grpc(int(rest[0])) if kind == "grpc" else serve_service(parse_config(rest)))
