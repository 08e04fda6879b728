"""The log lines of new streams, which clients can open a hundred times a second and under any name."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import cast

import grpc.aio
import pytest

from motiongen.v1 import service_pb2
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.sparing_log import QUIET_S, SparingLog
from motiongen_server.rpc.streams import reader as stream_reader
from motiongen_server.rpc.streams.reader import MAX_AGENT_CHARACTERS, MAX_SHOWN_CHARACTERS, StreamReader
from motiongen_server.rpc.streams.stream import Stream
from tests.server.rpc.streams.test_event_order import Line

NAME = stream_reader.__name__


@dataclass
class Context:
    """The context of a client that sends hello and nothing more."""

    agent: str
    said: list[object] = field(default_factory=list)

    def __post_init__(self) -> None:
        hello = service_pb2.ClientHello(client_agent=self.agent)
        self.said = [grpc.aio.EOF, service_pb2.StreamMotionRequest(hello=hello).SerializeToString()]

    async def read(self) -> object:
        return self.said.pop()


async def test_new_streams_are_logged_sparingly_and_with_short_names(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    line, now = Line(), [0.0]
    reader = StreamReader(line.models, "replica")
    reader._log = SparingLog(logging.getLogger(NAME), clock=lambda: now[0])

    async def begin(number: int, agent: str) -> None:
        await reader.read(Stream(number, line.models), cast(StreamContext, Context(agent)))

    for number in range(100):
        await begin(number, "engine 1.0")
    now[0] += QUIET_S
    unprintable = "\U000e0001" * MAX_AGENT_CHARACTERS
    await begin(100, unprintable)
    first, second = [record.getMessage() for record in caplog.records if record.name == NAME]
    assert first == "stream 0 begins, client 'engine 1.0'"
    shown = f"{repr(unprintable)[: MAX_SHOWN_CHARACTERS - 3]}..."
    assert second == f"stream 100 begins, client {shown} (and 99 like it since the last one)"
