"""How the application ends: on request, while loading, with a client that does not read, or by an engine failure."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import grpc
import grpc.aio
import numpy as np
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from numpy.typing import NDArray

from motiongen.v1 import service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.talk import Talk
from motiongen_server import app
from motiongen_server.app import SERVICE_NAME, Application, StoppedEarly
from motiongen_server.settings import SettingError
from tests.contract.local import LengthEncoder
from tests.server.application import NOT_SERVING, SERVING, SlowLoad, application_of, config, get, load
from tests.server.engine.fakes import FACTS
from tests.server.in_process import ENGINE, InProcessEngines, in_process
from tests.waiting import LIMIT_S, until_true


async def test_failed_start_closes_the_operations_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        application = application_of(config(port=taken.getsockname()[1]))
        with pytest.raises(SettingError, match="cannot listen"):
            await application.start()
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.1", application.ops_port)


async def test_stop_request_reports_not_serving_and_ends_with_code_0() -> None:
    async with asyncio.timeout(LIMIT_S):
        application = application_of(config())
        await application.start()
        async with grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel:
            watch = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest(service=SERVICE_NAME))
            assert (await watch.read()).status == SERVING
            application.ask_to_stop()
            await application.serve()
            draining = asyncio.create_task(application.drain())
            assert (await watch.read()).status == NOT_SERVING
            watch.cancel()
            assert await draining == 0


async def test_stop_request_while_loading_does_not_wait_for_the_model() -> None:
    slow = SlowLoad()
    async with asyncio.timeout(LIMIT_S):
        application = application_of(config(), slow)
        starting = asyncio.create_task(application.start())
        await slow.begun.wait()
        application.ask_to_stop()
        with pytest.raises(StoppedEarly):
            await starting
        async with grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel:
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                await service_pb2_grpc.MotionServiceStub(channel).GetCatalog(service_pb2.GetCatalogRequest())
        assert refused.value.code() is grpc.StatusCode.UNAVAILABLE
        await application.stop_ops()
    slow.may_end.set()


async def test_stop_request_does_not_wait_for_a_store_that_another_process_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, begun, may_end = asyncio.get_running_loop(), asyncio.Event(), threading.Event()

    def opened_late(*_: object) -> None:
        loop.call_soon_threadsafe(begun.set)
        assert may_end.wait(LIMIT_S)

    monkeypatch.setattr(app, "open_snapshot_store", opened_late)
    async with asyncio.timeout(LIMIT_S):
        application = application_of(config(snapshot_store=f"sqlite:{tmp_path}/a.sqlite"))
        starting = asyncio.create_task(application.start())
        await begun.wait()
        application.ask_to_stop()
        with pytest.raises(StoppedEarly):
            await starting
        await application.stop_ops()
    may_end.set()


class SlowlyMade(InProcessEngines):
    """Engines whose creation waits for the test; they log the calls of `stop` and `join`."""

    def __init__(self, *given: Any) -> None:
        begun, may_end, self._log = given[-3:]
        super().__init__(*given[:-3])
        begun()
        assert may_end.wait(LIMIT_S)

    def stop(self) -> None:
        self._log.append("stop")

    def join(self) -> bool:
        self._log.append("join")
        return True


async def test_engines_created_during_a_stop_request_are_stopped_too() -> None:
    loop, begun, may_end, log = asyncio.get_running_loop(), asyncio.Event(), threading.Event(), list[str]()

    def make(*given: Any) -> SlowlyMade:
        return SlowlyMade(*given, load, LengthEncoder(), lambda: loop.call_soon_threadsafe(begun.set), may_end, log)

    async with asyncio.timeout(LIMIT_S):
        application = Application(config(), make)
        starting = asyncio.create_task(application.start())
        await begun.wait()
        application.ask_to_stop()
        for _ in range(20):
            await asyncio.sleep(0)  # until the request is handled
        may_end.set()
        with pytest.raises(StoppedEarly):
            await starting
        await application.stop_ops()
    assert log == ["stop", "join"]


class SlowEncoder(LengthEncoder):
    """Encodes until the event loop has handled `close`."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.begun, self._may_end = asyncio.Event(), threading.Event()
        self.has_been_let = False

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        self._loop.call_soon_threadsafe(self.begun.set)
        self.has_been_let = self._may_end.wait(LIMIT_S / 4)
        return super().encode(texts)

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._may_end.set)


async def test_event_loop_runs_while_a_busy_encoder_is_closed() -> None:
    encoder = SlowEncoder()
    async with asyncio.timeout(LIMIT_S):
        application = Application(config(), in_process(load, encoder))
        await application.start()
        asking = asyncio.create_task(application._manager.kept[0].prompts.encode("a person walks"))
        await encoder.begun.wait()
        assert await application.drain() == 0
        assert encoder.has_been_let
        await asking


async def test_client_that_does_not_read_does_not_delay_the_end() -> None:
    async with asyncio.timeout(LIMIT_S):
        application = application_of(config(stream_events_per_second=1e7, peer_events_per_second=1e9))
        await application.start()
        async with grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel:
            stub = service_pb2_grpc.MotionServiceStub(channel)
            call = stub.StreamMotion()
            await call.write(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()))
            unknown = service_pb2.StreamMotionRequest(events=[session_pb2.SessionEvent(session=5)] * 50_000)
            value = application.metrics.registry.get_sample_value
            flooding = asyncio.create_task(call.write(unknown))
            await until_true(lambda: (value("motiongen_outbound_queue_bytes") or 0) >= 1 << 20)
            application.ask_to_stop()
            await application.serve()
            assert await application.drain() == 0
            call.cancel()
            await asyncio.gather(flooding, return_exceptions=True)


async def test_sessions_can_still_open_during_the_drain_wait() -> None:
    """Load balancers notice the changed health only some time later."""
    async with asyncio.timeout(LIMIT_S):
        application = application_of(config(drain_wait_s=600))
        await application.start()
        async with grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel:
            watch = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest(service=SERVICE_NAME))
            assert (await watch.read()).status == SERVING
            waiting = asyncio.create_task(application.drain())
            assert (await watch.read()).status == NOT_SERVING
            watch.cancel()
            stub = service_pb2_grpc.MotionServiceStub(channel)
            catalog = await stub.GetCatalog(service_pb2.GetCatalogRequest())  # type: ignore[misc]
            talk = await Talk(stub, catalog).hello()  # type: ignore[arg-type]
            await talk.open(1)
            for _ in range(2):
                application.ask_to_stop()  # the second request ends all waiting
            assert await waiting == 0


async def test_engine_failure_ends_the_application_with_code_1(caplog: pytest.LogCaptureFixture) -> None:
    application = application_of(config())

    def observe(report: object) -> None:
        raise RuntimeError("the books do not fit together")

    application.metrics.of_engine(FACTS.model_id, ENGINE).observe = observe  # type: ignore[method-assign]
    async with asyncio.timeout(LIMIT_S):
        await application.start()
        await application.serve()
        assert (await get(application, "/readyz")).status_code == 503
        assert (await get(application, "/livez")).status_code == 503
        assert await application.drain() == 1
    assert "the engine's loop failed" in caplog.text
