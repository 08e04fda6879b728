"""The application: starts, serves, drains, stops. The only place that connects the rooms."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import grpc.aio
from grpc_health.v1.health_pb2 import HealthCheckResponse

from motiongen_server.background import start_in_background
from motiongen_server.config import ServerConfig
from motiongen_server.engine.ports import Deliver
from motiongen_server.engine.types import Output
from motiongen_server.engine_process.pool import start_engine_processes
from motiongen_server.grpc_port import GrpcPort
from motiongen_server.identity.setup import listen, make_callers, make_ops_context, make_tls, warn_of_exposure
from motiongen_server.models.admin import AdminService, add_admin
from motiongen_server.models.factory import Engines, ModelFactory, make_limits
from motiongen_server.models.manager import ModelManager
from motiongen_server.ops.http import ops_app
from motiongen_server.ops.memory import FreedMemory, free_garbage, give_back_freed_memory
from motiongen_server.ops.metrics import Metrics
from motiongen_server.ops.port import OpsPort
from motiongen_server.ops.tracing import WindowSpans, open_window_spans
from motiongen_server.replicas.opening import open_other_servers
from motiongen_server.rpc.calls.health import Health
from motiongen_server.rpc.handlers import SERVICE_NAME
from motiongen_server.rpc.service import MotionService
from motiongen_server.rpc.starting import StartingService
from motiongen_server.settings import SettingError
from motiongen_server.snapshots.store import SnapshotStore
from motiongen_server.snapshots.stores import NONE, is_for_several_servers, open_snapshot_store, state_folder
from motiongen_server.transport import make_admin_server

_log = logging.getLogger("motiongen_server")

HEARTBEAT_LIMIT_S = 2.0
"""If the last heartbeat is older than this, the engine is too busy for more sessions."""
HUNG_S = 30.0
"""If the last heartbeat is older than this, the engine will not recover, and the process should be restarted."""
STOP_GRACE_S = 2.0
"""For streams that the drain's end closes, for engines still being started, and for calls when the port is shut."""
LAST_CALLS_S = 0.5
"""For the last answers to reach their clients; a call that only watches the health delays the end no longer."""

T = TypeVar("T")
MakeEngines = Callable[[ServerConfig, Deliver, Metrics], Engines]
"""Starts the engine processes, on a thread of its own. Raises SettingError."""


class StoppedEarly(Exception):
    """Raised when the server is asked to stop before it is ready."""


class Application:
    """One server process. `start`, then `serve` until a signal, then `drain`."""

    def __init__(self, config: ServerConfig, make_engines: MakeEngines = start_engine_processes) -> None:
        self._config = config
        self.metrics = Metrics()
        self._make_engines = make_engines
        self._engines: Engines | None = None
        self._factory = ModelFactory(config, self.metrics)
        self._manager = ModelManager(self._factory.load, self._factory.forget)
        self._snapshots: SnapshotStore | None = None
        self._spans: WindowSpans | None = None
        self._admin: grpc.aio.Server | None = None
        self._health = Health()
        self._stop, self._hurry = asyncio.Event(), asyncio.Event()
        self._door = StartingService()
        self._ready = False
        self._others_go_on = False
        self._freed = FreedMemory()
        self.grpc_port = self.ops_port = self.admin_port = 0

    # ---- startup ----------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Listen, load, warm up, and become ready.

        Raises SettingError if the settings cannot be served, StoppedEarly if asked to stop before it is ready.
        """
        tls, self._callers = make_tls(self._config), make_callers(self._config)
        self._port = GrpcPort(self._config, tls, self._door, self._health)
        self._tell_health()
        warn_of_exposure(self._config)
        self._spans = open_window_spans(self._config.trace_to, self._config.trace_share)
        await self._start_ops()
        try:
            await self._port.open()
            self.grpc_port = self._port.number
            await self._start_admin()
            await self._open()
        except Exception:
            await self._port.close(None)
            await self._stop_admin()
            await self._stop_engines()
            await self.stop_ops()
            if self._snapshots is not None:
                self._snapshots.close()
            raise

    async def _open(self) -> None:
        config = self._config
        folder, asked = state_folder(config.state_dir), config.snapshot_store
        open_store = partial(open_snapshot_store, asked, config.snapshot_keep_s, folder)
        self._snapshots = snapshots = await self._unless_stopped(start_in_background(open_store, "opening"))
        if snapshots is None:
            config = replace(config, snapshot_store=NONE)  # engines take no snapshots without a store
        self._loop = asyncio.get_running_loop()
        making = start_in_background(partial(self._make_engines, config, self._deliver, self.metrics), "starting")
        try:
            self._engines = await self._unless_stopped(asyncio.shield(making))
        except StoppedEarly:  # else processes that are being started would be left behind
            with contextlib.suppress(TimeoutError, SettingError, OSError):
                self._engines = await asyncio.wait_for(making, STOP_GRACE_S)
            raise
        self._factory.use(self._engines)
        for source in config.models:
            model = await self._unless_stopped(asyncio.ensure_future(self._factory.load(source)))
            if model.model_id in self._manager:
                raise SettingError(f"model is {config.model!r}, and two of these are {model.model_id}; give one")
            self._manager.adopt(model)
        self._service = MotionService(
            self._manager.models,
            config.flush_ms / 1000,
            stream_metrics=self.metrics,
            limits=make_limits(config),
            callers=self._callers,
            snapshots=snapshots,
            record_window=None if self._spans is None else self._spans.record,
            other_servers=None if snapshots is None else open_other_servers(asked, config.advertise_address),
        )
        if (durability := self._service.durability) is not None:
            self.metrics.watch_snapshots(durability.writer)
        self._manager.open(self._service)
        self._others_go_on = snapshots is not None and is_for_several_servers(config.snapshot_store)
        self._door.open(self._service)
        self.metrics.heartbeat_age.set_function(self._heartbeat_age_s)
        self.metrics.tasks.set_function(lambda: len(asyncio.all_tasks(self._loop)))
        self.metrics.watch_models(self._manager.models)
        self.metrics.watch_service(self._service)
        self.metrics.prompts_waiting.set_function(lambda: self._factory.num_waiting_prompts)
        self._ready = True
        self._tell_health()
        for model in self._manager.kept:
            _log.info("serving %s (weights: %s) on port %d, ops on port %d, with %s",
                      model.model_id, model.licence, self.grpc_port, self.ops_port, self._engines)  # fmt: skip
        if config.print_ports:
            ports = {"grpc_port": self.grpc_port, "ops_port": self.ops_port}
            print(json.dumps(ports | ({"admin_port": self.admin_port} if config.admin_listen else {})), flush=True)

    async def _unless_stopped(self, work: asyncio.Future[T]) -> T:
        """The result of `work`. Cancels it and raises StoppedEarly if the server is asked to stop first."""
        stopping = asyncio.create_task(self._stop.wait())
        either: set[asyncio.Future[Any]] = {work, stopping}
        await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        stopping.cancel()
        if work.done():
            return work.result()
        work.cancel()
        raise StoppedEarly

    async def _stop_engines(self) -> None:
        """Stop the engine processes, at once those that are still loading, and wait for their end."""
        if self._engines is not None:
            self._engines.stop()
            await start_in_background(self._engines.join, "stopping")

    def _deliver(self, outputs: Sequence[Output]) -> None:
        if outputs:
            self._service.deliver(outputs)
        elif self._others_go_on:  # no outputs: an engine process was lost, and its sessions have been told
            with contextlib.suppress(RuntimeError):  # the loop has been closed: the process is ending
                self._loop.call_soon_threadsafe(self._without_engines)

    def _without_engines(self) -> None:
        """If no engine is left, and other servers can continue the sessions, send the clients there instead of letting
        them wait for the next engine. Until there is one the port stays closed, since a refused connection makes every
        proxy try another server at once.
        """
        if self._ready and self._door.is_open and not self._engine_is_well(HEARTBEAT_LIMIT_S):
            _log.warning("no engine is left: clients are sent to other servers until there is one again")
            self._door.shut()
            self._service.send_away()
            self._port.shut(STOP_GRACE_S)

    async def _let_in_again(self) -> None:
        """Open the port again, since there is an engine."""
        try:
            await self._port.open()
        except SettingError as error:
            _log.error("%s; trying again", error)
        else:
            self._door.open(self._service)
            self._without_engines()  # the engine may be lost again, which is ignored while the door is shut

    async def _start_ops(self) -> None:
        refusal_of = partial(self._callers.metrics_refusal, self._config.ops_host)
        app = ops_app(self.metrics.registry, self._is_alive, self._is_ready, refusal_of)
        context = make_ops_context(self._config)
        self._ops = OpsPort(app, self._config.ops_host, self._config.ops_port, context)
        await self._ops.start()
        self.ops_port = self._ops.port

    async def _start_admin(self) -> None:
        address = self._config.admin_listen
        if not address:
            return
        self._admin = make_admin_server()
        add_admin(AdminService(self._manager, self.metrics.load_of, self._callers), self._admin)
        self.admin_port = listen(self._admin, address, " (admin)")
        await self._admin.start()

    async def _stop_admin(self) -> None:
        if self._admin is not None:
            await self._admin.stop(None)

    def _tell_health(self) -> None:
        """Report over gRPC what /readyz says: some proxies ask for the one, some for the other."""
        status = HealthCheckResponse.SERVING if self._is_ready() else HealthCheckResponse.NOT_SERVING
        for name in ("", SERVICE_NAME):
            self._health.set(name, status)

    def _is_alive(self) -> bool:
        return not self._ready or self._engine_is_well(HUNG_S)

    def _is_ready(self) -> bool:
        return self._ready and self._engine_is_well(HEARTBEAT_LIMIT_S)

    def _engine_is_well(self, limit_s: float) -> bool:
        return self._manager.failure is None and self._heartbeat_age_s() < limit_s

    def _heartbeat_age_s(self) -> float:
        return time.monotonic() - self._manager.heartbeat_at

    # ---- serve, drain, stop -----------------------------------------------------------------------------------------

    def ask_to_stop(self) -> None:
        """Begin to drain, as on SIGTERM. The second call: stop waiting for load balancers and clients."""
        if self._stop.is_set():
            self._hurry.set()
        self._stop.set()

    async def serve(self) -> None:
        """Return when asked to stop, or when no engine can be started any more."""
        while not self._stop.is_set() and self._manager.failure is None:
            self._manager.look_after()
            self._tell_health()
            if not self._door.is_open and self._engine_is_well(HEARTBEAT_LIMIT_S):
                await self._let_in_again()
            if self._freed.is_due(is_busy=(is_busy := self._service.num_streams > 0)):
                if not is_busy:
                    free_garbage()  # on this thread: garbage of gRPC calls belongs to their loop's thread
                await asyncio.to_thread(give_back_freed_memory)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), timeout=1.0)

    async def drain(self) -> int:
        """Report not ready, say goodbye, wait, close what is left, stop. Returns the exit code."""
        config = self._config
        _log.info("draining")
        self._ready = False
        self._tell_health()
        # Load balancers notice that only after a while; clients that they send until then are served.
        hurry = asyncio.create_task(self._hurry.wait())
        await asyncio.wait({hurry}, timeout=config.drain_wait_s)
        await self._stop_admin()
        self._manager.drain()
        self._service.goodbye(config.drain_grace_s)
        finished = asyncio.create_task(self._service.finished())
        await asyncio.wait({finished, hurry}, timeout=config.drain_grace_s, return_when=asyncio.FIRST_COMPLETED)
        self._service.close_all()
        await asyncio.wait({finished}, timeout=STOP_GRACE_S)
        hurry.cancel()
        # A client that does not read keeps its stream from ending; nothing more can be sent to it.
        await self._port.close(LAST_CALLS_S if finished.done() else None)
        finished.cancel()
        failed = self._manager.failure is not None
        await self._manager.stop()
        await asyncio.to_thread(self._service.write_last_snapshots)
        await self._stop_engines()
        await self.stop_ops()
        await asyncio.to_thread(self._factory.close)  # an encoder in this process may be at work
        _log.info("stopped%s", " after the engine failed" if failed else "")
        return 1 if failed else 0

    async def stop_ops(self) -> None:
        """Stop the HTTP server and the export of spans."""
        await self._ops.stop()
        if self._spans is not None:
            await asyncio.to_thread(self._spans.close)
