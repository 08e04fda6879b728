"""The channel of the C++ client: sockets, proxies, metadata, options, and tokens that are not sent."""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.client.fake_server import FakeServer
from tests.cpp.test_client import character

Program = Callable[[str], Path]


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer() as running:
        yield running


@pytest.fixture
def by_proxy() -> Iterator[dict[str, str]]:
    """Environment variables that name a proxy which never answers."""
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        port = deaf.getsockname()[1]
        yield {"grpc_proxy": f"http://127.0.0.1:{port}", "no_grpc_proxy": "", "no_proxy": ""}


def refusal(program: Program, address: str, **variables: str) -> str:
    """The reason that the client gives for not connecting."""
    done = subprocess.run(
        [program("told_events"), address],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **variables},
        check=False,
    )
    assert done.returncode == 1
    return done.stderr.splitlines()[-1]


def play(program: Program, address: str, **variables: str) -> None:
    with character(program, address, **variables) as walker:
        walker.tell("wait 20")
        assert walker.hear("frame")[2] == "OK"


def test_token_without_tls_is_refused_to_a_remote_address(program: Program, server: FakeServer) -> None:
    for address, others in (("motion.example:50051", ""), (server.address, "10.0.0.7:50051")):
        told = refusal(program, address, MOTIONGEN_TOKEN="secret", MOTIONGEN_OTHER=others)
        assert told.startswith("INVALID_INPUT tls: a token for ")
        assert "secret" not in told
    assert server.metadata == []


def test_client_connects_by_a_unix_socket_with_a_token(program: Program, tmp_path: Path) -> None:
    with FakeServer(listen=f"unix:{tmp_path / 's'}") as server:
        play(program, server.address, MOTIONGEN_TOKEN="secret")
        assert all(call["authorization"] == "Bearer secret" for call in server.metadata)
    assert refusal(program, "unix:").startswith("INVALID_INPUT address: ")


def test_metadata_and_options_reach_grpc(program: Program, server: FakeServer) -> None:
    play(
        program,
        server.address,
        MOTIONGEN_METADATA="x-route=blue,x-more=a b",
        MOTIONGEN_CHANNEL_OPTIONS="grpc.secondary_user_agent=game",
    )
    assert len(server.metadata) == 2, "the catalogue's call and the stream's"
    for call in server.metadata:
        assert (call["x-route"], call["x-more"]) == ("blue", "a b")
        assert str(call["user-agent"]).endswith("game")


def test_token_in_plain_text_is_not_sent_through_a_proxy(
    program: Program, server: FakeServer, by_proxy: dict[str, str]
) -> None:
    play(program, server.address, MOTIONGEN_TOKEN="secret", **by_proxy)
    play(program, server.address, MOTIONGEN_CHANNEL_OPTIONS="grpc.enable_http_proxy=0", **by_proxy)
