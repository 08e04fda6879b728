"""Reflection as tools use it: v1 and v1alpha, methods by their names, and files with all their dependencies."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager

import grpc
import grpc.aio
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from grpc_reflection.v1alpha.reflection_pb2 import ExtensionRequest, ServerReflectionRequest, ServerReflectionResponse

from motiongen_server.rpc.budgets.stream_budget import CALL_COST
from motiongen_server.rpc.calls import reflection
from motiongen_server.rpc.calls.reflection import MOST_QUESTION_BYTES, PACE_S, V1, V1ALPHA, add_reflection
from motiongen_server.rpc.handlers import SERVICE_NAME
from motiongen_server.rpc.limits import PeerLimits
from tests.waiting import LIMIT_S

NOT_FOUND = grpc.StatusCode.NOT_FOUND.value[0]


class Asker:
    """Asks questions of one version of reflection, by default one in each call."""

    def __init__(self, channel: grpc.aio.Channel, version: str) -> None:
        self._call = channel.stream_stream(
            f"/{version}/ServerReflectionInfo",
            request_serializer=ServerReflectionRequest.SerializeToString,
            response_deserializer=ServerReflectionResponse.FromString,
        )

    async def ask(self, request: ServerReflectionRequest) -> ServerReflectionResponse:
        (response,) = await self.ask_all([request])
        return response

    async def ask_all(self, requests: Iterable[ServerReflectionRequest]) -> list[ServerReflectionResponse]:
        """Asks all of them in one call."""
        return [response async for response in self._call(iter(requests), timeout=LIMIT_S)]

    async def files(self, symbol: str) -> dict[str, FileDescriptorProto]:
        response = await self.ask(ServerReflectionRequest(file_containing_symbol=symbol))
        found = response.file_descriptor_response.file_descriptor_proto
        return {file.name: file for file in map(FileDescriptorProto.FromString, found)}


@asynccontextmanager
async def served(version: str, limits: PeerLimits = reflection.LIMITS) -> AsyncIterator[Asker]:
    server = grpc.aio.server()
    add_reflection([SERVICE_NAME], server, limits=limits)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        yield Asker(channel, version)
    await server.stop(None)


@pytest.fixture(params=[V1, V1ALPHA])
async def asker(request: pytest.FixtureRequest) -> AsyncIterator[Asker]:
    async with served(request.param) as asker:
        yield asker


async def test_services_are_listed_with_both_versions_of_reflection(asker: Asker) -> None:
    listed = (await asker.ask(ServerReflectionRequest(list_services=""))).list_services_response.service
    assert [service.name for service in listed] == sorted([SERVICE_NAME, V1, V1ALPHA])


@pytest.mark.parametrize(
    "symbol",
    [
        SERVICE_NAME,
        f"{SERVICE_NAME}.GetCatalog",
        f"{SERVICE_NAME}.StreamMotion",
        "motiongen.v1.Limits",
        "motiongen.v1.Limits.max_prompts",
    ],
)
async def test_symbol_is_found_with_the_files_that_its_own_depends_on(asker: Asker, symbol: str) -> None:
    files = await asker.files(symbol)
    assert "motiongen/v1/service.proto" in files
    assert {needed for file in files.values() for needed in file.dependency} <= set(files)


@pytest.mark.parametrize("version", [V1, V1ALPHA])
async def test_reflection_finds_itself(asker: Asker, version: str) -> None:
    for symbol in (version, f"{version}.ServerReflectionInfo"):
        (file,) = (await asker.files(symbol)).values()
        assert f"{file.package}.{file.service[0].name}" == version
        assert file.service[0].method[0].input_type == f".{file.package}.ServerReflectionRequest"
    by_name = await asker.ask(ServerReflectionRequest(file_by_filename=file.name))
    assert by_name.file_descriptor_response.file_descriptor_proto == [file.SerializeToString()]


@pytest.mark.parametrize(
    "request_",
    [
        ServerReflectionRequest(file_containing_symbol=f"{SERVICE_NAME}.NoSuchMethod"),
        ServerReflectionRequest(file_containing_symbol="motiongen.v1.NoSuchService.GetCatalog"),
        ServerReflectionRequest(file_containing_symbol=""),
        ServerReflectionRequest(file_by_filename="no/such.proto"),
        ServerReflectionRequest(all_extension_numbers_of_type="motiongen.v1.NoSuchMessage"),
        ServerReflectionRequest(
            file_containing_extension=ExtensionRequest(containing_type="motiongen.v1.Rig", extension_number=5)
        ),
    ],
    ids=str,
)
async def test_unknown_names_are_not_found(asker: Asker, request_: ServerReflectionRequest) -> None:
    assert (await asker.ask(request_)).error_response.error_code == NOT_FOUND


async def test_messages_have_no_extensions(asker: Asker) -> None:
    asked = ServerReflectionRequest(all_extension_numbers_of_type="motiongen.v1.Rig")
    told = (await asker.ask(asked)).all_extension_numbers_response
    assert (told.base_type_name, list(told.extension_number)) == ("motiongen.v1.Rig", [])


# ---- what it costs ---------------------------------------------------------------------------------------------------

LISTED = ServerReflectionRequest(list_services="")
ENDLESS_HZ = 1e9


async def refusal(asker: Asker, request: ServerReflectionRequest) -> tuple[grpc.StatusCode, str]:
    """The code and details with which a call ends."""
    with pytest.raises(grpc.aio.AioRpcError) as refused:
        await asker.ask(request)
    return refused.value.code(), refused.value.details() or ""


async def test_question_that_is_too_long_is_refused(asker: Asker) -> None:
    allowed = ServerReflectionRequest(file_containing_symbol="a" * (MOST_QUESTION_BYTES - 3))
    assert allowed.ByteSize() == MOST_QUESTION_BYTES
    assert (await asker.ask(allowed)).error_response.error_code == NOT_FOUND
    too_long = ServerReflectionRequest(file_containing_symbol="a" * (MOST_QUESTION_BYTES - 2))
    code, details = await refusal(asker, too_long)
    assert code is grpc.StatusCode.INVALID_ARGUMENT
    assert f"has {MOST_QUESTION_BYTES + 1} bytes; at most {MOST_QUESTION_BYTES} are allowed" in details


@pytest.mark.parametrize("of", ["calls_per_second", "bytes_per_second"])
async def test_questions_and_answers_are_paid_for_before_more_is_read(of: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rested: list[float] = []

    async def rest(seconds: float) -> None:
        rested.append(seconds)
        await asyncio.sleep(0)

    monkeypatch.setattr(reflection, "_sleep", rest)
    # The budget is not replenished while the test lasts.
    limits = {"calls_per_second": ENDLESS_HZ, "bytes_per_second": ENDLESS_HZ, of: 1e-6}
    async with asyncio.timeout(LIMIT_S), served(V1, PeerLimits(**limits)) as asker:  # type: ignore[arg-type]
        first, second = await asker.ask_all([LISTED] * 2)
        if of == "calls_per_second":
            charged = [CALL_COST * number for number in (2, 3)]
        else:
            each = LISTED.ByteSize() + first.ByteSize()
            charged = [float(each), each + LISTED.ByteSize() + second.ByteSize()]
        assert [seconds * 1e-6 for seconds in rested] == pytest.approx(charged, abs=1e-3)
        code, details = await refusal(asker, LISTED)
        assert code is grpc.StatusCode.RESOURCE_EXHAUSTED
        assert "asks for more reflection than it may" in details


async def test_client_without_debt_is_answered_at_the_usual_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    rested: list[float] = []

    async def rest(seconds: float) -> None:
        rested.append(seconds)

    monkeypatch.setattr(reflection, "_sleep", rest)
    async with asyncio.timeout(LIMIT_S), served(V1) as asker:
        assert len(await asker.ask_all([LISTED] * 20)) == 20
    assert rested == [PACE_S] * 20
