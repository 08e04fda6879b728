"""The servicer's border with the engine's thread; its behaviour on the wire is tested in tests/contract."""

from __future__ import annotations

import asyncio

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.engine.types import Code, Guidance, Outcome, SessionKey
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.limits import Limits
from motiongen_server.rpc.service import MotionService
from motiongen_server.text.prompts import PromptEncoder
from tests.contract.local import LengthEncoder, LocalServer
from tests.server.engine.fakes import FACTS
from tests.server.rpc.streams.test_giving_up import stream_of
from tests.server.rpc.streams.test_stream_watch import connected, talk_on
from tests.waiting import LIMIT_S

STRAY = Outcome(SessionKey(99, 1), 2, Code.OK)


class NoEngine:
    def submit(self, event: object) -> None:
        raise AssertionError("nothing is submitted here")


async def test_outputs_for_a_client_that_has_gone_are_dropped_and_others_get_theirs() -> None:
    faults: list[dict[str, object]] = []
    async with asyncio.timeout(LIMIT_S), LocalServer() as server, connected(server) as (channel, catalog):
        asyncio.get_running_loop().set_exception_handler(lambda _, fault: faults.append(fault))
        talk = await talk_on(channel, catalog).hello()
        number = stream_of(await talk.open(1))
        talk.note(service_pb2.StreamMotionRequest(events=[session_pb2.SessionEvent(session=9, event_seq=78)]))
        told = [Outcome(SessionKey(number, 9), seq, Code.NOT_FOUND, reason="TOLD", message="told") for seq in (77, 78)]
        server.service.deliver([STRAY, told[0]])
        await asyncio.to_thread(server.service.deliver, [STRAY, told[1]])
        await asyncio.sleep(0)  # lets the event loop take them
        assert faults == []
        await talk.until(lambda: 9 in talk.sessions and talk.sessions[9].outcome(78))
        assert [outcome.event_seq for outcome in talk.sessions[9].outcomes] == [77, 78]
        talk.call.cancel()


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
