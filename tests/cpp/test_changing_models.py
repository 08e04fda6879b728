"""The C++ client and a server whose models come and go: the catalogue is requested again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import grpc

from motiongen.v1 import service_pb2, session_pb2
from tests.client.fake_server import FakeServer
from tests.cpp.test_client import character
from tests.waiting import until

Program = Callable[[str], Path]


class Changing(FakeServer):
    """Offers another model and rig in its first catalogue."""

    def __init__(self) -> None:
        super().__init__()
        self.num_asked = 0

    def GetCatalog(
        self, request: service_pb2.GetCatalogRequest, context: grpc.ServicerContext
    ) -> service_pb2.GetCatalogResponse:
        self.num_asked += 1
        response = super().GetCatalog(request, context)
        if self.num_asked == 1:
            for rig in response.rigs:
                rig.rig_id = "earlier"
            for model in response.models:
                model.rig_id = model.model_id = "earlier"
            response.catalog_etag = "earlier"
        return response


def test_session_on_a_rig_added_since_connecting_plays(program: Program) -> None:
    with Changing() as server, character(program, server.address) as walker:
        walker.hear("opened")
        walker.tell("wait 40")
        assert walker.hear("frame")[2] == "OK"
        assert server.num_asked == 2


def test_unknown_model_makes_the_client_request_the_catalogue_again(program: Program) -> None:
    with Changing() as server:
        server.refuse = lambda event: "UNKNOWN_MODEL" if event.HasField("open") else ""
        with character(program, server.address) as walker:
            assert walker.hear("closed")[1] == "UNKNOWN_MODEL"
            until(lambda: server.num_asked == 2)


def test_velocity_set_before_the_opening_keeps_its_duration(program: Program) -> None:
    with FakeServer(frame_rate=50) as server:
        has_said = threading.Event()

        def open_late(event: session_pb2.SessionEvent) -> str:
            if event.HasField("open"):
                has_said.wait()
            return ""

        server.refuse = open_late
        with character(program, server.address) as walker:
            try:
                walker.tell("velocity 0 1 seconds=2")
                walker.tell("stats")
                walker.hear("stats")
            finally:
                has_said.set()
            assert walker.hear("edit")[2] == "OK"
            (told,) = (event for event in server.stream.received if event.HasField("set_velocity"))
            assert told.set_velocity.hold_frames == 100
