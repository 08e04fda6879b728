"""Models that come and go while a client is connected: it requests the catalogue again, once, and continues."""

from __future__ import annotations

import threading
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
from tests.waiting import LIMIT_S

NUM_FRAMES = 8
G1 = SessionOptions(model_id="g1")


class Changing(FakeServer):
    """Its models change on demand: "synthetic" has the rig stick9, all others have one with wider rows.

    asked: the etags of the requests for its catalogue.
    """

    def __init__(self, replica_id: str = "fake") -> None:
        super().__init__(replica_id=replica_id)
        self.asked: list[str] = []
        self.refuse = lambda event: "UNKNOWN_MODEL" if self._is_unknown(event.open) else ""
        self.offer("synthetic")

    def offer(self, *model_ids: str) -> None:
        """Offer these models from now on, the default first."""
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


async def clip_model_and_rig(client: MotionClient, options: SessionOptions | None = None) -> tuple[str, str]:
    """The model of a clip, and the rig with which its frames were read."""
    (clip,) = await client.generate_clip("walk", num_frames=NUM_FRAMES, options=options)
    return clip.model_id, clip.motion.rig.rig_id


async def test_clip_of_a_model_loaded_since_is_made_after_one_catalogue_request(
    client: MotionClient, server: Changing
) -> None:
    server.offer("synthetic", "g1")
    assert await clip_model_and_rig(client, G1) == ("g1", "wide")
    assert names(client) == ["synthetic", "g1"]
    assert server.asked == ["", "synthetic"]
    assert await clip_model_and_rig(client) == ("synthetic", "stick9")
    assert len(server.asked) == 2


async def test_enormous_timeouts_do_not_expire_at_once(server: Changing) -> None:
    """gRPC takes a deadline some centuries ahead for one that has passed."""
    async with MotionClient(server.address, connect_timeout_s=1e12) as client:
        (clip,) = await client.generate_clip("walk", num_frames=NUM_FRAMES, timeout_s=1e12)
        assert len(clip.motion) == NUM_FRAMES


async def test_catalogue_read_by_a_stream_is_shared_with_the_client_and_its_streams(
    client: MotionClient, server: Changing
) -> None:
    server.offer("synthetic", "g1")
    await client.open("walk", options=G1)
    assert names(client) == ["synthetic", "g1"]
    async with client.stream() as stream:
        await stream.open("walk", options=G1)
    assert await clip_model_and_rig(client, G1) == ("g1", "wide")
    assert server.asked == ["", "synthetic"]


async def test_client_learns_of_new_models_when_a_stream_reconnects(client: MotionClient, server: Changing) -> None:
    session = await client.open("walk")
    server.offer("synthetic", "g1")
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)
    await until(lambda: session.stats.reopenings)
    assert names(client) == ["synthetic", "g1"]


async def test_clip_without_a_model_id_uses_the_default_of_the_known_catalogue(
    client: MotionClient, server: Changing
) -> None:
    server.offer("g1")
    assert await clip_model_and_rig(client) == ("g1", "wide")
    assert names(client) == ["g1"]
    server.offer("synthetic", "g1")
    assert await clip_model_and_rig(client) == ("g1", "wide"), "the default of the catalogue that the client has"


async def test_unknown_model_is_looked_up_again_once_and_then_refused(client: MotionClient, server: Changing) -> None:
    with pytest.raises(UnknownName, match="no model is called 'g1'; known are: synthetic"):
        await clip_model_and_rig(client, G1)
    assert server.asked == ["", "synthetic"]
    server.offer("g1")
    with pytest.raises(EventRefused, match="UNKNOWN_MODEL"):
        await clip_model_and_rig(client, SessionOptions(model_id="synthetic"))


async def test_server_without_models_can_be_used_once_it_has_some(client: MotionClient, server: Changing) -> None:
    server.offer()
    with pytest.raises(UnknownName, match=r"known are: \(none\)"):
        await clip_model_and_rig(client)
    assert names(client) == []
    server.offer("synthetic")
    await client.open("walk")
    assert await clip_model_and_rig(client) == ("synthetic", "stick9")


async def test_catalogue_of_another_server_does_not_replace_the_clients_own(server: Changing) -> None:
    with Changing("other") as other:
        other.offer("g1")
        async with MotionClient(server.address, other_addresses=[other.address]) as client:
            server.refuse = full((other.address, ""))
            await client.open("walk")
            assert other.stream.characters
            assert names(client) == ["synthetic"]


def test_blocking_client_also_learns_of_new_models(server: Changing) -> None:
    with blocking.MotionClient(server.address) as client:
        server.offer("g1")
        (clip,) = client.generate_clip("walk", num_frames=NUM_FRAMES)
        assert clip.model_id == "g1"
        assert names(client) == ["g1"]


class Leaving(Changing):
    """Ends its stream when it is asked for its catalogue again, and does not answer, or with a failure."""

    answers = True

    def GetCatalog(
        self, request: service_pb2.GetCatalogRequest, context: grpc.ServicerContext
    ) -> service_pb2.GetCatalogResponse:
        if self.asked.count("synthetic") == 0 and self.streams:
            self.asked.append(request.catalog_etag)
            self.stream.fail(grpc.StatusCode.UNAVAILABLE)
            if self.answers:
                context.abort(grpc.StatusCode.UNAVAILABLE, "it is going away")
            gone = threading.Event()
            if context.add_callback(gone.set):
                gone.wait(LIMIT_S)
        return super().GetCatalog(request, context)


@pytest.mark.parametrize("answers", [True, False])
async def test_opening_waits_for_the_next_connection_if_one_is_lost_while_models_are_looked_up(answers: bool) -> None:
    with Leaving() as server:
        server.answers = answers
        async with MotionClient(server.address) as client, client.stream() as stream:
            await stream.open("stand")
            server.offer("synthetic", "g1")
            session = await stream.open("walk", options=G1)
            assert session.opened.model_id == "g1"
            assert len(server.streams) == 2
