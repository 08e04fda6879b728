"""The C++ client, destroyed or reconnected while gRPC still reports the end of the call that was lost."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from motiongen.v1 import session_pb2
from tests.client.fake_server import FakeServer

Program = Callable[[str], Path]
WAYS = ("callback", "events", "slowly")  # arguments of lost_clients
COUNT, SESSIONS = 20, 500
PATIENCE_S = 200.0
SPOILS_FREED_MEMORY = "glibc.malloc.tcache_count=0:glibc.malloc.perturb=165"  # so that code which uses it crashes


@pytest.fixture
def server() -> Iterator[FakeServer]:
    """A server that ends each stream when its last session asks to open, and answers nothing."""

    def refuse(event: session_pb2.SessionEvent) -> session_pb2.EditOutcome:
        if event.HasField("open") and event.session == SESSIONS:
            running.stream.end()
        return session_pb2.EditOutcome()  # an open gets no answer

    with FakeServer() as running:
        running.refuse = refuse
        yield running


@pytest.mark.parametrize("way", WAYS)
def test_lost_call_is_not_used_after_it_is_destroyed(program: Program, server: FakeServer, way: str) -> None:
    command = [program("lost_clients"), server.address, str(COUNT), str(SESSIONS), way]
    subprocess.run(command, check=True, timeout=PATIENCE_S, env={**os.environ, "GLIBC_TUNABLES": SPOILS_FREED_MEMORY})
