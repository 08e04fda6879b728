"""Calls that send no request, malformed requests, or do not read their answers."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import pytest
from google.rpc import error_details_pb2
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_status import rpc_status

from motiongen.v1 import service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.talk import Talk
from motiongen_server.rpc.limits import PeerLimits, ServiceLimits
from motiongen_server.rpc.streams import writer as stream_writer
from tests.attack.hostile_calls import NARROW
from tests.channels import ALONE
from tests.contract.local import LocalServer
from tests.raw_calls import answer_to, status_in
from tests.server.application import SERVING, config, running
from tests.waiting import LIMIT_S, until_true

MOTION = "/motiongen.v1.MotionService/"
ADMIN = "/motiongen.v1.MotionAdminService/"
CHECK, WATCH = "/grpc.health.v1.Health/Check", "/grpc.health.v1.Health/Watch"
CLIP = f"{MOTION}GenerateClip"
OF_ONE_REQUEST = (
    f"{MOTION}GetCatalog",
    CLIP,
    CHECK,
    WATCH,
    f"{ADMIN}ListModels",
    f"{ADMIN}LoadModel",
)
REFLECTION = tuple(f"/grpc.reflection.{version}.ServerReflection/ServerReflectionInfo" for version in ("v1", "v1alpha"))
GARBAGE = b"\xff"
UNIMPLEMENTED = grpc.StatusCode.UNIMPLEMENTED.value[0]


@asynccontextmanager
async def channels(**settings: object) -> AsyncIterator[tuple[grpc.aio.Channel, grpc.aio.Channel]]:
    """Channels to the gRPC port and to the administration port."""
    async with running(config(admin_listen="127.0.0.1:0", **settings)) as application:
        addresses = (f"127.0.0.1:{port}" for port in (application.grpc_port, application.admin_port))
        first, second = (grpc.aio.insecure_channel(address) for address in addresses)
        async with first, second:
            yield first, second


async def end_of(channel: grpc.aio.Channel, path: str, sends: Sequence[bytes], is_over: bool = True) -> tuple[Any, str]:
    """Status code and reason with which a call ends. is_over: the client closes its side."""
    call = channel.stream_stream(path)()
    with contextlib.suppress(grpc.aio.AioRpcError, asyncio.InvalidStateError):  # it may have been ended already
        for message in sends:
            await call.write(message)
        if is_over:
            await call.done_writing()
    code = await call.code()
    error = grpc.aio.AioRpcError(
        code, await call.initial_metadata(), await call.trailing_metadata(), await call.details()
    )
    status, info = rpc_status.from_call(error), error_details_pb2.ErrorInfo()
    for detail in status.details if status is not None else ():
        detail.Unpack(info)
    return code, info.reason


@pytest.mark.parametrize(
    ("sends", "is_over", "end"),
    [
        ((), False, (grpc.StatusCode.DEADLINE_EXCEEDED, "REQUEST_LATE")),
        ((), True, (grpc.StatusCode.UNIMPLEMENTED, "ONE_REQUEST_EXPECTED")),
        ((b"", b""), True, (grpc.StatusCode.UNIMPLEMENTED, "ONE_REQUEST_EXPECTED")),
        ((GARBAGE,), True, (grpc.StatusCode.INVALID_ARGUMENT, "MALFORMED_REQUEST")),
    ],
    ids=["headers alone", "no request", "two requests", "garbage"],
)
async def test_call_without_one_valid_request_gets_a_reason_and_is_not_logged(
    sends: Sequence[bytes], is_over: bool, end: tuple[grpc.StatusCode, str], caplog: pytest.LogCaptureFixture
) -> None:
    is_late = end[1] == "REQUEST_LATE"
    async with channels(hello_timeout_s=0.2 if is_late else 60.0) as (motion, admin):
        for path in OF_ONE_REQUEST:
            assert await end_of(admin if path.startswith(ADMIN) else motion, path, sends, is_over) == end, path
        if not is_late:  # with the short timeout, a busy machine could be late itself
            catalog = service_pb2_grpc.MotionServiceStub(motion).GetCatalog(service_pb2.GetCatalogRequest())
            assert (await catalog).models[0].model_id == "fake"  # type: ignore[misc]
    assert not [record for record in caplog.records if record.levelname in ("WARNING", "ERROR")]


async def test_too_long_request_is_refused_before_the_client_closes_its_side() -> None:
    too_long = b"\x7a\x80\x20" + b"a" * 4096  # an unknown field
    async with channels(hello_timeout_s=60.0) as (motion, admin):
        for path in OF_ONE_REQUEST:
            if path != CLIP:
                end = await end_of(admin if path.startswith(ADMIN) else motion, path, [too_long], is_over=False)
                assert end == (grpc.StatusCode.INVALID_ARGUMENT, "REQUEST_TOO_LONG"), path


async def test_method_name_that_is_not_text_is_unimplemented_and_harmless(caplog: pytest.LogCaptureFixture) -> None:
    async with running(config(admin_listen="127.0.0.1:0")) as application:
        for port, service in ((application.grpc_port, MOTION), (application.admin_port, ADMIN)):
            for path in (b"\xff", f"{service}".encode() + b"\xff"):
                assert status_in(await asyncio.to_thread(answer_to, port, path)) == UNIMPLEMENTED
        async with (
            grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}") as motion,
            grpc.aio.insecure_channel(f"127.0.0.1:{application.admin_port}") as admin,
        ):
            check = health_pb2_grpc.HealthStub(motion).Check(health_pb2.HealthCheckRequest())
            assert (await check).status == SERVING
            assert await admin.unary_unary(f"{ADMIN}ListModels")(b"")
    assert not [record for record in caplog.records if record.levelname in ("WARNING", "ERROR")]


async def test_malformed_reflection_request_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    async with channels() as (motion, _):
        for path in REFLECTION:
            assert await end_of(motion, path, [GARBAGE]) == (grpc.StatusCode.INVALID_ARGUMENT, "MALFORMED_REQUEST")
    assert not [record for record in caplog.records if record.levelname in ("WARNING", "ERROR")]


async def test_malformed_requests_count_against_the_call_rate() -> None:
    async with channels(peer_calls_per_second=1.0) as (motion, _):
        ends = [await end_of(motion, f"{MOTION}GetCatalog", [GARBAGE]) for _ in range(20)]
        assert (grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_CALLS") in ends


async def test_calls_cancelled_before_their_request_are_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    async with running(config(peer_calls_per_second=1e6)) as application:
        address = f"127.0.0.1:{application.grpc_port}"
        async with (
            grpc.aio.insecure_channel(address, options=ALONE) as gone,
            grpc.aio.insecure_channel(
                address, options=ALONE
            ) as other,  # separate: gRPC may refuse a connection that cancelled hundreds of calls
        ):
            for number in range(300):
                call = gone.stream_unary(OF_ONE_REQUEST[number % 4])()
                await asyncio.sleep(0)
                call.cancel()
            check = health_pb2_grpc.HealthStub(other).Check(health_pb2.HealthCheckRequest())
            assert (await check).status == SERVING
    assert not [record for record in caplog.records if record.levelname in ("WARNING", "ERROR")]


async def test_unread_answers_count_as_open_calls_and_leave_others_alone() -> None:
    async with running(config(peer_calls=3)) as application:
        address = f"127.0.0.1:{application.grpc_port}"
        asked = service_pb2.GetCatalogRequest()
        async with (
            grpc.aio.insecure_channel(address, options=(*ALONE, *NARROW)) as narrow,
            grpc.aio.insecure_channel(address, options=ALONE) as other,
        ):
            unread = [narrow.unary_stream(f"{MOTION}GetCatalog")(b"") for _ in range(20)]
            ended = [asyncio.ensure_future(call.code()) for call in unread]
            await until_true(lambda: sum(code.done() for code in ended) == 17)
            assert {code.result() for code in ended if code.done()} == {grpc.StatusCode.RESOURCE_EXHAUSTED}
            stub = service_pb2_grpc.MotionServiceStub(other)
            assert (await stub.GetCatalog(asked)).models[0].model_id == "fake"  # type: ignore[misc]
            for call in unread:
                call.cancel()
            await asyncio.gather(*ended, return_exceptions=True)
        async with grpc.aio.insecure_channel(address, options=ALONE) as again:
            stub = service_pb2_grpc.MotionServiceStub(again)
            for _ in range(5):
                await stub.GetCatalog(asked)  # type: ignore[misc]


@pytest.mark.parametrize("events", [0, 20_000], ids=["a hello", "more than it can pay for behind it"])
async def test_stream_with_a_blocked_answer_holds_its_place_until_its_client_goes(
    events: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(stream_writer, "LAST_WRITE_S", 0.0)
    limits = ServiceLimits(peer=PeerLimits(streams=2))
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        grpc.aio.insecure_channel(server.address, options=(*ALONE, *NARROW)) as narrow,
        grpc.aio.insecure_channel(server.address, options=ALONE) as other,
    ):
        call = narrow.stream_stream(f"{MOTION}StreamMotion")()
        await call.write(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()).SerializeToString())
        if events:
            asked = service_pb2.StreamMotionRequest(events=[session_pb2.SessionEvent()] * events)
            await call.write(asked.SerializeToString())
        await until_true(lambda: server.service.num_streams)
        (stuck,) = server.service._streams.values()
        await until_true(lambda: stuck.writing_since is not None or stuck.refusal is not None)
        if stuck.writing_since is not None:
            stuck.writing_since -= limits.stuck_timeout_s  # only this stream: on a busy machine others may be slow
        await until_true(lambda: stuck.refusal is not None)
        stub = service_pb2_grpc.MotionServiceStub(other)
        talk = await Talk(stub, await stub.GetCatalog(service_pb2.GetCatalogRequest())).hello()  # type: ignore[misc]
        await talk.ping(20)
        assert server.service.num_streams == 2
        call.cancel()
        await until_true(lambda: server.service.num_streams == 1)
        talk.call.cancel()
    assert not [record for record in caplog.records if record.levelname == "ERROR"]
