"""The servicer's border with the engine's thread; its behaviour on the wire is tested in tests/contract."""

from __future__ import annotations

import asyncio

from motiongen_server.engine.types import Code, Guidance, Outcome, SessionKey
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.limits import Limits
from motiongen_server.rpc.service import MotionService
from motiongen_server.text.prompts import PromptEncoder
from tests.contract.local import LengthEncoder, LocalServer
from tests.server.engine.fakes import FACTS

STRAY = Outcome(SessionKey(99, 1), 2, Code.OK)


class NoEngine:
    def submit(self, event: object) -> None:
        raise AssertionError("nothing is submitted here")


async def test_outputs_for_a_client_that_has_gone_are_dropped() -> None:
    async with LocalServer() as server:
        server.service.deliver([STRAY])
        await asyncio.to_thread(server.service.deliver, [STRAY])
        await asyncio.sleep(0)  # lets the event loop take them
        assert server.service.num_streams == 0


def test_outputs_after_the_event_loop_ended_are_dropped() -> None:
    async def make() -> MotionService:
        prompts = PromptEncoder(LengthEncoder(), 1)
        catalog = Catalog(
            FACTS, Limits(), Guidance(2.0, 2.0), "CC0-1.0", text_encoder=prompts.identity, history_frames=16
        )
        return MotionService(ModelRegistry(LoadedModel("fake", NoEngine(), prompts, catalog)))

    asyncio.run(make()).deliver([STRAY])


async def test_service_without_streams_finishes_at_once() -> None:
    async with LocalServer() as server:
        server.service.goodbye(1.0)
        server.service.close_all()
        await server.service.finished()
