"""A server inside the test process: the real service and engine over gRPC, a fake runner and a fake text encoder."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace

import grpc
import grpc.aio
import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.types import Gait, Guidance, ModelFacts, Owner
from motiongen_server.identity.callers import Callers
from motiongen_server.identity.setup import listen
from motiongen_server.identity.tls import ServerTls
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.replicas.other_servers import OtherServers
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities
from motiongen_server.rpc.budgets.loop_time import UNLIMITED
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.handlers import add_methods
from motiongen_server.rpc.limits import Limits, PeerLimits, ServiceLimits
from motiongen_server.rpc.service import MotionService
from motiongen_server.snapshots.store import SnapshotStore
from motiongen_server.text.prompts import PromptEncoder
from tests.server.engine.engine_thread import EngineThread
from tests.server.engine.fakes import FACTS, FakeRunner, RealTime
from tests.waiting import LIMIT_S

ANY_LOAD = (1000.0, 1000.0, 1000.0, 1000.0)
UNMETERED = 1e9
"""Events per second, for tests of what comes after the budget."""
ANY_TIME = ServiceLimits(loop_share=UNLIMITED)
"""Limits with which no test depends on how fast the machine handles a message."""
NO_BUDGET = ServiceLimits(loop_share=UNLIMITED, peer=PeerLimits(events_per_second=UNMETERED))


class LengthEncoder:
    """Embeds a text by its length."""

    identity = "length-1"

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        return np.array([[len(text), 0] for text in texts], np.float32)


class LocalEngine(Engine):
    """An engine of this process with the interface that the service uses."""

    def note_owner(self, owner: Owner) -> None:
        self.intake.note_owner(owner)


class LocalServer:
    """Use as `async with LocalServer() as server`. address: where it listens.

    listen: unix:PATH, or a host and the port 0.
    """

    def __init__(
        self,
        limits: Limits | None = None,
        engine_config: EngineConfig | None = None,
        *,
        abilities: Abilities = NOTHING_CLAIMED,
        gaits: tuple[Gait, ...] = (),
        facts: ModelFacts = FACTS,
        service_limits: ServiceLimits | None = None,
        callers: Callers | None = None,
        tls: ServerTls | None = None,
        snapshots: SnapshotStore | None = None,
        other_servers: OtherServers | None = None,
        listen: str = "127.0.0.1:0",
    ) -> None:
        self._listen = listen
        self._other_servers = other_servers
        self._snapshots = snapshots
        self._callers = callers
        self._tls = tls
        self._facts = facts
        self._service_limits = service_limits
        self.limits = limits or Limits()
        self._abilities = abilities
        self._gaits = gaits
        # It plays in real time: without the other settings, sessions would be refused or degraded on a busy machine.
        self._engine_config = replace(
            engine_config or EngineConfig(), snapshots=snapshots is not None, admit_load=ANY_LOAD, degrade=False
        )

    async def __aenter__(self) -> LocalServer:
        limits = self.limits
        self.runner = FakeRunner(RealTime(), facts=self._facts)
        self.prompts = PromptEncoder(LengthEncoder(), 1000)
        self.engine = LocalEngine(self.runner, self.runner.clock, self._deliver, self._engine_config)
        catalog = Catalog(
            self._facts,
            limits,
            Guidance(2.0, 2.0),
            "CC0-1.0",
            text_encoder=self.prompts.identity,
            history_frames=16,
            gaits=self._gaits,
            abilities=self._abilities,
        )
        self.model = LoadedModel("fake", self.engine, self.prompts, catalog)
        self.service = MotionService(
            ModelRegistry(self.model),
            limits=self._service_limits or ANY_TIME,
            callers=self._callers,
            snapshots=self._snapshots,
            other_servers=self._other_servers,
        )
        self._server = grpc.aio.server(options=[("grpc.max_receive_message_length", limits.max_request_bytes)])
        add_methods(self.service, self._server)
        port = listen(self._server, self._listen, "", self._tls)
        self.address = self._listen if port == 0 else self._listen.rpartition(":")[0] + f":{port}"
        await self._server.start()
        self._thread = EngineThread(self.engine)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._server.stop(None)
        self.engine.stop()
        assert await asyncio.to_thread(self._thread.join, LIMIT_S)
        await asyncio.to_thread(self.service.write_last_snapshots)
        self.prompts.close()
        assert self._thread.failure is None
        assert self.runner.breaches == [], self.runner.breaches

    def _deliver(self, outputs: object) -> None:
        self.service.deliver(outputs)  # type: ignore[arg-type]
