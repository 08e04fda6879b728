"""The pytest plugin of the command: which server, and how it is reached."""

from __future__ import annotations

from pathlib import Path

import grpc
import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("motiongen")
    group.addoption("--server-address", help="host:port")
    group.addoption("--server-ca", type=Path, help="certificates to trust, PEM; without them, plain text is spoken")
    group.addoption("--server-certificate", type=Path, help="certificate to show, PEM")
    group.addoption("--server-key", type=Path, help="its key, PEM")
    group.addoption("--server-token-file", type=Path, help="file with the token that says who calls")


@pytest.fixture(scope="session")
def server_address(request: pytest.FixtureRequest) -> str:
    return str(request.config.getoption("--server-address"))


@pytest.fixture(scope="session")
def server_credentials(request: pytest.FixtureRequest) -> grpc.ChannelCredentials | None:
    names = ("--server-ca", "--server-key", "--server-certificate")
    paths: list[Path | None] = [request.config.getoption(name) for name in names]
    authorities, key, certificate = (None if path is None else path.read_bytes() for path in paths)
    return None if authorities is None else grpc.ssl_channel_credentials(authorities, key, certificate)


@pytest.fixture(scope="session")
def server_token(request: pytest.FixtureRequest) -> str:
    path: Path | None = request.config.getoption("--server-token-file")
    return "" if path is None else path.read_text(encoding="utf-8").strip()
