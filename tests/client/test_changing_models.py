"""Models that come and go while a client is connected: it asks for the catalogue again, once, and goes on."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator

import grpc
import numpy as np
import pytest
from google.rpc import error_details_pb2, status_pb2  # type: ignore[import-untyped]

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_client import EventRefused, MotionClient, SessionOptions, UnknownName, blocking
from tests.client.fake_server import FakeServer, full
from tests.client.synthetic import ROW_WIDTH, catalog
from tests.client.waiting import until

NUM_FRAMES = 8
G1 = SessionOptions(model_id="g1")


class Changing(FakeServer):
    """Its models change when a test says so: "synthetic" is of the rig stick9, all others of one with wider rows.

    asked: the etags that it was asked with.
    """

    def __init__(self, replica_id: str = "fake") -> None:
        super().__init__(replica_id=replica_id)
        self.asked: list[str] = []
        self.refuse = lambda event: "UNKNOWN_MODEL" if self._is_unknown(event.open) else ""
        self.offer("synthetic")

    def offer(self, *model_ids: str) -> None:
        """From now on it has these, the default first."""
        offered = catalog(self.frame_rate)
        offered.catalog_etag = " ".join(model_ids)
        offered.limits.max_clip_frames = NUM_FRAMES
        offered.limits.max_clip_samples = 1
        wide = offered.rigs.add()
        wide.CopyFrom(offered.rigs[0])
        wide.rig_id = "wide"
        wide.blocks.add(name="more", width=2)
        (model,) = offered.models
        del offered.models[:]
        for model_id in model_ids:
            model.model_id, model.rig_id = model_id, "stick9" if model_id == "synthetic" else "wide"
            offered.models.append(model)
        self.offered = offered

    def _is_unknown(self, opening: session_pb2.OpenSession) -> bool:
        return opening.model_id not in ("", *(model.model_id for model in self.offered.models))

    def GetCatalog(
        self, request: service_pb2.GetCatalogRequest, context: grpc.ServicerContext
    ) -> service_pb2.GetCatalogResponse:
        self.asked.append(request.catalog_etag)
        if request.catalog_etag == self.offered.catalog_etag:
            return service_pb2.GetCatalogResponse(catalog_etag=request.catalog_etag)
        return self.offered

    def GenerateClip(
        self, request: service_pb2.GenerateClipRequest, context: grpc.ServicerContext
    ) -> Iterator[service_pb2.GenerateClipResponse]:
        if self._is_unknown(request.open):
            status = status_pb2.Status(code=5, message="no such model is served")
            status.details.add().Pack(error_details_pb2.ErrorInfo(reason="UNKNOWN_MODEL", domain="motiongen"))
            context.set_trailing_metadata((("grpc-status-details-bin", status.SerializeToString()),))
            context.abort(grpc.StatusCode.NOT_FOUND, "no such model is served")
        model_id = request.open.model_id or self.offered.models[0].model_id
        rig_id, more = ("stick9", 0) if model_id == "synthetic" else ("wide", 2)
        rows = np.zeros((NUM_FRAMES, ROW_WIDTH + more), "<f4")
        chunk = motion_pb2.FrameChunk(
            frame_count=NUM_FRAMES, data=rows.tobytes(), scalar_type=motion_pb2.SCALAR_TYPE_F32_LE
        )
        opened = session_pb2.SessionOpened(model_id=model_id, rig_id=rig_id)
        yield service_pb2.GenerateClipResponse(opened=opened)
        yield service_pb2.GenerateClipResponse(chunk=chunk)
        yield service_pb2.GenerateClipResponse(summary=service_pb2.ClipSummary())


@pytest.fixture
def server() -> Iterator[Changing]:
    with Changing() as running:
        yield running


@pytest.fixture
async def client(server: Changing) -> AsyncIterator[MotionClient]:
    async with MotionClient(server.address) as connected:
        yield connected


def names(client: MotionClient | blocking.MotionClient) -> list[str]:
    return [model.model_id for model in client.catalog.models]


async def made(client: MotionClient, options: SessionOptions | None = None) -> tuple[str, str]:
    """The model of a clip, and the rig that its frames were read by."""
    (clip,) = await client.generate_clip("walk", num_frames=NUM_FRAMES, options=options)
    return clip.model_id, clip.motion.rig.rig_id


async def test_clips_are_had_of_a_model_that_was_loaded_since(client: MotionClient, server: Changing) -> None:
    server.offer("synthetic", "g1")
    assert await made(client, G1) == ("g1", "wide")
    assert names(client) == ["synthetic", "g1"]
    assert server.asked == ["", "synthetic"]
    assert await made(client) == ("synthetic", "stick9")
    assert len(server.asked) == 2


async def test_who_has_all_the_time_there_is_is_not_too_late_at_once(server: Changing) -> None:
    """gRPC takes a time beyond some centuries for one that is over."""
    async with MotionClient(server.address, connect_timeout_s=1e12) as client:
        (clip,) = await client.generate_clip("walk", num_frames=NUM_FRAMES, timeout_s=1e12)
        assert len(clip.motion) == NUM_FRAMES


async def test_what_a_stream_hears_of_models_the_client_knows_and_its_next_stream_too(
    client: MotionClient, server: Changing
) -> None:
    server.offer("synthetic", "g1")
    await client.open("walk", options=G1)
    assert names(client) == ["synthetic", "g1"]
    async with client.stream() as stream:
        await stream.open("walk", options=G1)
    assert await made(client, G1) == ("g1", "wide")
    assert server.asked == ["", "synthetic"]


async def test_the_client_knows_what_is_heard_with_another_line(client: MotionClient, server: Changing) -> None:
    session = await client.open("walk")
    server.offer("synthetic", "g1")
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)
    await until(lambda: session.stats.reopenings)
    assert names(client) == ["synthetic", "g1"]


async def test_a_clip_of_no_model_by_name_is_of_the_default_whichever_that_is(
    client: MotionClient, server: Changing
) -> None:
    server.offer("g1")
    assert await made(client) == ("g1", "wide")
    assert names(client) == ["g1"]
    server.offer("synthetic", "g1")
    assert await made(client) == ("g1", "wide"), "the default of the catalogue that the client has"


async def test_a_model_that_nobody_has_is_asked_for_once(client: MotionClient, server: Changing) -> None:
    with pytest.raises(UnknownName, match="no model is called 'g1'; known are: synthetic"):
        await made(client, G1)
    assert server.asked == ["", "synthetic"]
    server.offer("g1")
    with pytest.raises(EventRefused, match="UNKNOWN_MODEL"):
        await made(client, SessionOptions(model_id="synthetic"))


async def test_a_server_without_models_is_no_mistake_of_the_client(client: MotionClient, server: Changing) -> None:
    server.offer()
    with pytest.raises(UnknownName, match=r"known are: \(none\)"):
        await made(client)
    assert names(client) == []
    server.offer("synthetic")
    await client.open("walk")
    assert await made(client) == ("synthetic", "stick9")


async def test_models_of_another_server_are_none_of_the_client_s_own(server: Changing) -> None:
    with Changing("other") as other:
        other.offer("g1")
        async with MotionClient(server.address, other_addresses=[other.address]) as client:
            server.refuse = full((other.address, ""))
            await client.open("walk")
            assert other.stream.characters
            assert names(client) == ["synthetic"]


def test_without_asyncio_it_is_the_same(server: Changing) -> None:
    with blocking.MotionClient(server.address) as client:
        server.offer("g1")
        (clip,) = client.generate_clip("walk", num_frames=NUM_FRAMES)
        assert clip.model_id == "g1"
        assert names(client) == ["g1"]
