"""The pytest plugin of the command: which server to test, how to reach it, and when to give up."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Any

import grpc
import grpc.aio
import pytest

from motiongen_compliance.reach import credentials_of, token_of

MOST_UNANSWERED = 3
"""How many tests in a row may time out or find the server unavailable; after that, the remaining tests are not run."""
_GONE = (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED)
_UNANSWERED = pytest.StashKey[int]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("motiongen")
    group.addoption("--server-address", help="host:port")
    group.addoption("--server-ca", type=Path, help="certificates to trust, PEM; without it, plain text is used")
    group.addoption("--server-certificate", type=Path, help="the client's certificate, PEM")
    group.addoption("--server-key", type=Path, help="its key, PEM")
    group.addoption("--server-token-file", type=Path, help="file with the caller's token")


@pytest.fixture(scope="session")
def server_address(request: pytest.FixtureRequest) -> str:
    return str(request.config.getoption("--server-address"))


@pytest.fixture(scope="session")
def server_credentials(request: pytest.FixtureRequest) -> grpc.ChannelCredentials | None:
    names = ("--server-ca", "--server-key", "--server-certificate")
    return credentials_of(*(request.config.getoption(name) for name in names))


@pytest.fixture(scope="session")
def server_token(request: pytest.FixtureRequest) -> str:
    return token_of(request.config.getoption("--server-token-file"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Give up where a server that is asked again and again does not answer: each test waits for a minute or more."""
    report = yield
    failure = None if call.excinfo is None else call.excinfo.value
    if _is_in_vain(failure):
        item.session.stash[_UNANSWERED] = item.session.stash.get(_UNANSWERED, 0) + 1
    elif call.when == "call":
        item.session.stash[_UNANSWERED] = 0
    if item.session.stash.get(_UNANSWERED, 0) >= MOST_UNANSWERED:
        given_up = f"the server did not answer in {MOST_UNANSWERED} tests in a row; the others were not run"
        item.session.shouldfail = given_up
    return report


def _is_in_vain(failure: Any) -> bool:
    if isinstance(failure, grpc.aio.AioRpcError):
        return failure.code() in _GONE
    return isinstance(failure, TimeoutError)
