"""The pytest plugin of the command: which server, and how it is reached."""

from __future__ import annotations

from pathlib import Path

import grpc
import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("motiongen")
    group.addoption("--server-address", help="host:port")
    group.addoption("--server-ca", type=Path, help="certificates to trust, PEM; without them, plain text is spoken")


@pytest.fixture(scope="session")
def server_address(request: pytest.FixtureRequest) -> str:
    return str(request.config.getoption("--server-address"))


@pytest.fixture(scope="session")
def server_credentials(request: pytest.FixtureRequest) -> grpc.ChannelCredentials | None:
    path: Path | None = request.config.getoption("--server-ca")
    return None if path is None else grpc.ssl_channel_credentials(path.read_bytes())
