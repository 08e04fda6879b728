"""The client of a server's admin service, against a server that gives unusual answers."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import grpc
import pytest

from motiongen.v1 import admin_pb2, admin_pb2_grpc
from motiongen_client import InvalidInput, StreamLost
from motiongen_client.admin import AdminClient
from tests.client.waiting import until
from tests.waiting import LIMIT_S


class Admin(admin_pb2_grpc.MotionAdminServiceServicer):
    """Its models have a state that no client knows, and loading one never ends."""

    def __init__(self) -> None:
        self.is_asked = False

    def ListModels(
        self, request: admin_pb2.ListModelsRequest, context: grpc.ServicerContext
    ) -> admin_pb2.ListModelsResponse:
        status = admin_pb2.ModelStatus(model_id="one")
        status.state = 9  # type: ignore[assignment]
        return admin_pb2.ListModelsResponse(models=[status])

    def LoadModel(
        self, request: admin_pb2.LoadModelRequest, context: grpc.ServicerContext
    ) -> admin_pb2.LoadModelResponse:
        self.is_asked = True
        gone = threading.Event()
        if context.add_callback(gone.set):
            gone.wait(LIMIT_S)
        return admin_pb2.LoadModelResponse()


@pytest.fixture
def served() -> Iterator[tuple[Admin, str]]:
    admin, threads = Admin(), ThreadPoolExecutor(4)
    server = grpc.server(threads)
    admin_pb2_grpc.add_MotionAdminServiceServicer_to_server(admin, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield admin, f"127.0.0.1:{port}"
    server.stop(None).wait()
    threads.shutdown()


async def test_unknown_model_state_is_read_as_unspecified(served: tuple[Admin, str]) -> None:
    async with AdminClient(served[1]) as client:
        (status,) = await client.list_models()
    assert (status.model_id, status.state) == ("one", "unspecified")


async def test_closing_the_client_ends_a_pending_load_with_stream_lost(served: tuple[Admin, str]) -> None:
    admin, address = served
    client = AdminClient(address)
    loading = asyncio.create_task(client.load_model("tiny"))
    await until(lambda: admin.is_asked)
    await client.close()
    with pytest.raises(StreamLost, match="the client was closed"):
        await loading


@pytest.mark.parametrize("grace_s", [-1.0, math.nan, math.inf, 3601.0])
async def test_invalid_grace_is_refused_by_the_client(served: tuple[Admin, str], grace_s: float) -> None:
    async with AdminClient(served[1]) as client:
        for call in (client.unload_model, client.reload_model):
            with pytest.raises(InvalidInput, match="grace_s"):
                await call("one", grace_s)
