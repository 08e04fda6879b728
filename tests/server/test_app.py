"""The application with a fake model: loading, ready, serving, and settings that do not fit the model."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace

import grpc
import grpc.aio
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_ardy.checkpoint.model_card import BUILT_IN_MODEL
from motiongen_ardy.model.packed.graphs import sizes_up_to
from motiongen_compliance.talk import Talk
from motiongen_server.addresses import join_address
from motiongen_server.app import SERVICE_NAME
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.trial_jobs import usual_passes
from motiongen_server.engine_process.model_loading import build_engine, load_model, record_graphs
from motiongen_server.models.manager import ModelManager
from motiongen_server.settings import SettingError
from tests.server.application import NOT_SERVING, SERVING, SlowLoad, application_of, config, get, running
from tests.server.engine.fakes import FACTS, FakeRunner, RealTime
from tests.waiting import LIMIT_S, until_true


async def test_loading_server_is_alive_but_not_ready() -> None:
    slow = SlowLoad()
    application = application_of(config(), slow)
    async with asyncio.timeout(LIMIT_S):
        starting = asyncio.create_task(application.start())
        await slow.begun.wait()
        assert (await get(application, "/livez")).status_code == 200
        assert (await get(application, "/readyz")).status_code == 503
        assert (await get(application, "/metrics")).status_code == 200
        slow.may_end.set()
        await starting
        assert (await get(application, "/readyz")).status_code == 200
        assert await application.drain() == 0


async def test_loading_server_answers_calls_with_unavailable() -> None:
    slow = SlowLoad()
    application = application_of(config(), slow)
    async with asyncio.timeout(LIMIT_S):
        starting = asyncio.create_task(application.start())
        await slow.begun.wait()
        async with grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel:
            watch = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest(service=SERVICE_NAME))
            assert (await watch.read()).status == NOT_SERVING
            stub = service_pb2_grpc.MotionServiceStub(channel)
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                await stub.GetCatalog(service_pb2.GetCatalogRequest())  # type: ignore[misc]
            assert refused.value.code() is grpc.StatusCode.UNAVAILABLE
            stream = stub.StreamMotion()
            assert await stream.code() is grpc.StatusCode.UNAVAILABLE
            slow.may_end.set()
            await starting
            assert (await watch.read()).status == SERVING
            watch.cancel()
            catalog = await stub.GetCatalog(service_pb2.GetCatalogRequest())  # type: ignore[misc]
            talk = await Talk(stub, catalog).hello()  # type: ignore[arg-type]
            await talk.open(1)
            await talk.call.done_writing()
            assert await talk.to_the_end() is grpc.StatusCode.OK
        assert await application.drain() == 0


async def test_health_reflection_and_metrics_are_served() -> None:
    async with (
        running(config()) as application,
        grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel,
    ):
        health = health_pb2_grpc.HealthStub(channel)
        for service in ("", SERVICE_NAME):
            assert (await health.Check(health_pb2.HealthCheckRequest(service=service))).status == SERVING
        call = reflection_pb2_grpc.ServerReflectionStub(channel).ServerReflectionInfo()
        await call.write(reflection_pb2.ServerReflectionRequest(list_services=""))
        listed = {service.name for service in (await call.read()).list_services_response.service}
        assert {"motiongen.v1.MotionService", "grpc.health.v1.Health"} <= listed
        call.cancel()
        metrics = (await get(application, "/metrics")).text
        assert 'motiongen_build_info{model="fake",rig="fake"} 1.0' in metrics
        assert "motiongen_engine_heartbeat_age_seconds" in metrics


async def test_grpc_health_follows_readyz_while_the_engine_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    async with (
        running(config()) as application,
        grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel,
    ):
        serving = asyncio.create_task(application.serve())
        watch = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest(service=SERVICE_NAME))
        assert (await watch.read()).status == SERVING
        with monkeypatch.context() as hung:
            hung.setattr(ModelManager, "heartbeat_at", -math.inf)
            assert (await watch.read()).status == NOT_SERVING
            assert (await get(application, "/readyz")).status_code == 503
        assert (await watch.read()).status == SERVING
        watch.cancel()
        application.ask_to_stop()
        await serving


async def test_port_is_shut_again_if_the_engine_is_lost_while_it_reopens(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with running(config()) as application:
        with monkeypatch.context() as lost:
            lost.setattr(ModelManager, "heartbeat_at", -math.inf)
            application._without_engines()
            assert not application._port.is_open
            await application._let_in_again()
            assert not application._port.is_open, "an open port would attract clients that other servers could take"
            assert not application._door.is_open
        await application._let_in_again()
        assert application._port.is_open
        assert application._door.is_open


async def test_losing_the_engine_shuts_the_port_even_without_sessions(monkeypatch: pytest.MonkeyPatch) -> None:
    async with running(config()) as application:
        with monkeypatch.context() as lost:
            lost.setattr(application, "_others_go_on", True)
            application._deliver(())  # an empty delivery while the engine lives, as after an unload
            await asyncio.sleep(0)
            assert application._port.is_open
            lost.setattr(ModelManager, "heartbeat_at", -math.inf)
            await asyncio.to_thread(application._deliver, ())
            await until_true(lambda: not application._port.is_open)
        await application._let_in_again()


async def test_limits_guidance_and_licence_are_in_the_catalogue() -> None:
    settings = config(max_prompt_characters=77, max_sessions_per_stream=5, text_guidance=1.25)
    async with (
        running(settings) as application,
        grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        catalog = await stub.GetCatalog(service_pb2.GetCatalogRequest())  # type: ignore[misc]
        assert (catalog.limits.max_prompt_characters, catalog.limits.max_sessions_per_stream) == (77, 5)
        assert (catalog.models[0].licence, catalog.models[0].default_guidance.text) == ("CC0-1.0", 1.25)


async def test_stream_beyond_the_limit_is_refused() -> None:
    async with (
        running(config(max_streams=1)) as application,
        grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as channel,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        catalog = await stub.GetCatalog(service_pb2.GetCatalogRequest())  # type: ignore[misc]
        first = await Talk(stub, catalog).hello()  # type: ignore[arg-type]
        second = Talk(stub, catalog)  # type: ignore[arg-type]
        assert await second.to_the_end() is grpc.StatusCode.RESOURCE_EXHAUSTED
        await first.open(1)


async def test_start_message_names_model_licence_ports_and_engines(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "motiongen_server"):
        async with running(config()) as application:
            pass
    (line,) = [line for line in caplog.messages if line.startswith("serving")]
    assert line == (
        f"serving fake (weights: CC0-1.0) on port {application.grpc_port}, ops on port {application.ops_port}, "
        "with an engine of this process"
    )


@pytest.mark.parametrize(
    ("host", "address"),
    [
        ("127.0.0.1", "127.0.0.1:50051"),
        ("localhost", "localhost:50051"),
        ("::1", "[::1]:50051"),
        ("::", "[::]:50051"),
        ("unix:a.sock", "unix:a.sock"),
    ],
)
def test_ipv6_hosts_are_bracketed_in_addresses(host: str, address: str) -> None:
    assert join_address(host, 50051) == address


def test_missing_cuda_is_reported_with_the_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(SettingError, match=r"devices has cuda, .* use cpu"):
        load_model(config(), BUILT_IN_MODEL, "cuda")


def test_model_device_steps_precision_and_graphs_reach_the_runner(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[object, ...]] = []

    def remember(*given: object) -> FakeRunner:
        asked.append(given)
        return FakeRunner(RealTime(), facts=replace(FACTS, embedding_dim=256))  # the width of the model's prompt domain

    monkeypatch.setattr("motiongen_server.runner.load_runner", remember)
    load_model(config(denoise_steps=5, precision="bfloat16", cuda_graphs=True), BUILT_IN_MODEL)
    assert asked == [(BUILT_IN_MODEL, "cpu", 5, "bfloat16", True)]


def test_graphs_are_recorded_for_every_batch_size_that_can_be_served() -> None:
    runner, device = FakeRunner(), Device()
    record_graphs(config(max_rows=6), runner, device)
    first_steps = [len(batch) for batch in runner.batches[:: runner.facts.min_steps]]
    histories = len(range(0, 16 + 1, runner.facts.patch))  # every history length, as sessions begin with short ones
    assert first_steps == [size for size in sizes_up_to(6, usual_passes(runner)) for _ in range(histories)]
    assert first_steps[-1] == 6
    assert device.num_seats == 0, "recording keeps no seat at the device"


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"denoise_steps": 11}, "denoise_steps is 11; fake takes 2 to 10"),
        ({"lookahead_frames": 20}, "lookahead_frames is 20; fake needs at least 40"),
        ({"max_lookahead_frames": 36}, "max_lookahead_frames is 36; fake needs at least 40"),
        ({"history_frames": 400}, "history_frames is 400; fake takes at most 160"),
        ({"host": "256.0.0.1", "insecure": True}, "cannot listen on 256.0.0.1:0"),
    ],
)
async def test_settings_that_do_not_fit_the_model_are_refused_by_name(settings: dict[str, object], named: str) -> None:
    application = application_of(config(**settings))
    async with asyncio.timeout(LIMIT_S):
        with pytest.raises(SettingError, match=named):
            await application.start()
        await application.stop_ops()


def test_model_that_generates_non_finite_frames_is_not_served() -> None:
    with pytest.raises(SettingError, match="not finite"):
        build_engine(config(), FakeRunner(poisoned_result=lambda job: True), lambda outputs: None, lambda report: None)
