"""The encoder service's process: load, serve, drain."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import sys
from functools import partial
from pathlib import Path

from grpc_health.v1 import health_pb2
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector

from motiongen_ardy.text import TextEncoder, load_text_encoder
from motiongen_ardy.text.store import VectorStore
from motiongen_server.addresses import join_address
from motiongen_server.identity.setup import listen, make_callers, make_ops_context, make_tls, warn_of_exposure
from motiongen_server.ops.http import ops_app
from motiongen_server.ops.port import OpsPort
from motiongen_server.rpc.calls.call_pace import calls_a_second
from motiongen_server.rpc.calls.health import Health, add_health
from motiongen_server.rpc.calls.requests import Requests
from motiongen_server.rpc.grpc_server import make_server
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.settings import SettingError
from motiongen_server.text.encoder.config import EncoderConfig
from motiongen_server.text.encoder.service import SERVICE_NAME, TextEncoderService, add_text_encoder
from motiongen_server.text.prompts import PromptEncoder
from motiongen_server.transport import HANDSHAKE_MS, allowed_connections

_log = logging.getLogger("motiongen_server.text.encoder")

MOST_REQUEST_BYTES = 64 << 20
CALLS_OF_A_PEER = 1024
"""Calls open at once; many servers may share one address."""
ENCODING_BUCKETS = (0.001, 0.005, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)


class EncoderApplication:
    """One process of the encoder service. `start`, then `drain` when asked to stop."""

    def __init__(self, config: EncoderConfig) -> None:
        self._config = config
        self._registry = CollectorRegistry()
        self._health = Health()
        self._is_ready = False

    async def start(self) -> None:
        """Load the encoder, then listen. Raises SettingError if the settings cannot be served."""
        config = self._config
        tls, self._callers = make_tls(config), make_callers(config)
        warn_of_exposure(config)
        encoder = await asyncio.to_thread(load, config)
        self._prompts = self._make_prompts(encoder)
        self._server = make_server(
            options=[
                ("grpc.so_reuseport", 0),
                ("grpc.max_receive_message_length", most_bytes(config)),
                ("grpc.max_allowed_incoming_connections", allowed_connections()),
                ("grpc.server_handshake_timeout_ms", HANDSHAKE_MS),
            ],
            calls_a_second=calls_a_second(config.address_calls_per_second, config.peer_calls_per_second),
        )
        limits = PeerLimits(
            calls=CALLS_OF_A_PEER,
            prompts_per_second=config.peer_texts_per_second,
            calls_per_second=config.peer_calls_per_second,
        )
        service = TextEncoderService(
            self._prompts, encoder.width, config.max_texts, config.max_characters, self._callers, limits
        )
        requests = Requests()
        add_text_encoder(service, self._server, requests)
        add_health(self._health, self._server, requests)
        self._port = listen(self._server, join_address(config.host, config.port), "", tls)
        try:
            await self._start_ops()
            await self._server.start()
        except SettingError:
            await self._server.stop(None)
            raise
        self._set_health(health_pb2.HealthCheckResponse.SERVING)
        self._is_ready = True
        _log.info("serving text encoder %s, %d numbers, on port %d", encoder.identity, encoder.width, self._port)
        if config.print_ports:
            print(json.dumps({"grpc_port": self._port, "ops_port": self._ops.port}), flush=True)

    def _make_prompts(self, encoder: TextEncoder) -> PromptEncoder:
        config, registry = self._config, self._registry
        seconds = Histogram(
            "motiongen_encoder_seconds", "Time to encode a new text, waiting included.", buckets=ENCODING_BUCKETS,
            registry=registry,
        )  # fmt: skip
        texts = Counter(
            "motiongen_encoder_texts",
            "Texts that were not in memory: from the store, from the encoder, or why they were refused.",
            ["source"],
            registry=registry,
        )
        waiting = Gauge("motiongen_encoder_waiting", "Texts that wait for the encoder.", registry=registry)
        ProcessCollector(registry=registry)
        store = None
        if config.store:
            store = VectorStore(Path(config.store), encoder.identity, encoder.width, config.store_size)
        prompts = PromptEncoder(
            encoder,
            config.cache,
            observe=seconds.observe,
            store=store,
            timeout_s=config.timeout_s,
            max_waiting=config.max_waiting,
            count=lambda source: texts.labels(source).inc(),
        )
        waiting.set_function(lambda: prompts.num_waiting)
        return prompts

    async def _start_ops(self) -> None:
        config = self._config
        refusal_of = partial(self._callers.metrics_refusal, config.ops_host)
        app = ops_app(self._registry, lambda: True, lambda: self._is_ready, refusal_of)
        self._ops = OpsPort(app, config.ops_host, config.ops_port, make_ops_context(config))
        await self._ops.start()

    def _set_health(self, status: int) -> None:
        for name in ("", SERVICE_NAME):
            self._health.set(name, status)

    async def drain(self) -> None:
        """Report not ready, let running requests finish, and stop."""
        self._is_ready = False
        self._set_health(health_pb2.HealthCheckResponse.NOT_SERVING)
        await self._server.stop(self._config.drain_grace_s)
        await self._ops.stop()
        await asyncio.to_thread(self._prompts.close)
        _log.info("stopped")


def load(config: EncoderConfig) -> TextEncoder:
    """The configured encoder. Raises SettingError."""
    if config.device == "cuda" or config.threads:
        import torch

        if config.device == "cuda" and not torch.cuda.is_available():
            raise SettingError("device is 'cuda', but torch finds no CUDA device and driver here; use cpu")
        if config.threads:
            torch.set_num_threads(config.threads)
    try:
        return load_text_encoder(
            config.text_encoder, config.width or None, config.device, config.precision, config.timeout_s
        )
    except (ValueError, RuntimeError, OSError) as error:
        raise SettingError(f"cannot serve text encoder {config.text_encoder!r}: {error}") from error


def most_bytes(config: EncoderConfig) -> int:
    """Size of the largest request: as many texts as it may have, with four bytes for each character."""
    return min(config.max_texts * (4 * config.max_characters + 8) + 4096, MOST_REQUEST_BYTES)


async def run(config: EncoderConfig) -> int:
    """Start, serve until SIGTERM or SIGINT, drain. Returns the process's exit code."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    application = EncoderApplication(config)
    starting = asyncio.create_task(application.start())
    stopping = asyncio.create_task(stop.wait())
    await asyncio.wait({starting, stopping}, return_when=asyncio.FIRST_COMPLETED)
    if not starting.done():
        _log.info("stopped before it was ready")
        os._exit(0)  # the loading thread cannot be interrupted, and holds nothing that needs cleaning up
    try:
        starting.result()
    except SettingError as error:
        stopping.cancel()
        print(f"error: {error}", file=sys.stderr)
        return 2
    await stopping
    await application.drain()
    return 0
