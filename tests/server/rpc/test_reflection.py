"""Reflection as tools use it: v1 before v1alpha, methods by their names, and every file that those found need."""

from __future__ import annotations

from collections.abc import AsyncIterator

import grpc
import grpc.aio
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from grpc_reflection.v1alpha.reflection_pb2 import ExtensionRequest, ServerReflectionRequest, ServerReflectionResponse

from motiongen_server.rpc.handlers import SERVICE_NAME
from motiongen_server.rpc.reflection import V1, V1ALPHA, add_reflection
from tests.waiting import LIMIT_S

NOT_FOUND = grpc.StatusCode.NOT_FOUND.value[0]


class Asker:
    """Asks one question a call, of one version."""

    def __init__(self, channel: grpc.aio.Channel, version: str) -> None:
        self._call = channel.stream_stream(
            f"/{version}/ServerReflectionInfo",
            request_serializer=ServerReflectionRequest.SerializeToString,
            response_deserializer=ServerReflectionResponse.FromString,
        )

    async def ask(self, request: ServerReflectionRequest) -> ServerReflectionResponse:
        (response,) = [response async for response in self._call(iter([request]), timeout=LIMIT_S)]
        return response

    async def files(self, symbol: str) -> dict[str, FileDescriptorProto]:
        response = await self.ask(ServerReflectionRequest(file_containing_symbol=symbol))
        found = response.file_descriptor_response.file_descriptor_proto
        return {file.name: file for file in map(FileDescriptorProto.FromString, found)}


@pytest.fixture(params=[V1, V1ALPHA])
async def asker(request: pytest.FixtureRequest) -> AsyncIterator[Asker]:
    server = grpc.aio.server()
    add_reflection([SERVICE_NAME], server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        yield Asker(channel, request.param)
    await server.stop(None)


async def test_the_services_are_listed_with_both_versions(asker: Asker) -> None:
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
async def test_a_symbol_is_found_with_all_that_it_needs(asker: Asker, symbol: str) -> None:
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
async def test_what_there_is_not_is_not_found(asker: Asker, request_: ServerReflectionRequest) -> None:
    assert (await asker.ask(request_)).error_response.error_code == NOT_FOUND


async def test_no_message_of_ours_has_extensions(asker: Asker) -> None:
    asked = ServerReflectionRequest(all_extension_numbers_of_type="motiongen.v1.Rig")
    told = (await asker.ask(asked)).all_extension_numbers_response
    assert (told.base_type_name, list(told.extension_number)) == ("motiongen.v1.Rig", [])
