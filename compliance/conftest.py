"""In this repository the suite runs against servers started here: one in this process, one with engine processes."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator

import pytest

from motiongen_server.engine.config import EngineConfig
from tests.conftest import ROOT
from tests.contract.local import LocalServer
from tests.waiting import LIMIT_S

FAST = 1000.0
"""Rate, relative to real time, at which playheads earn credit here: the tests take motion as fast as it comes."""


@pytest.fixture(scope="session")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a server with two engine processes; checks that it exits cleanly."""
    log = tmp_path_factory.mktemp("gateway") / "stderr.txt"
    with log.open("w", encoding="utf-8") as errors:
        command = [sys.executable, "-m", "tests.contract.gateway"]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True)
        assert process.stdout is not None
        with process.stdout:
            address = process.stdout.readline().strip()
            assert address, log.read_text()
            yield address
            process.send_signal(signal.SIGTERM)
            exit_code = process.wait(LIMIT_S)
    assert exit_code == 0, log.read_text()


@pytest.fixture(params=["in this process", "two engine processes"])
async def server_address(request: pytest.FixtureRequest) -> AsyncIterator[str]:
    if request.param == "two engine processes":
        yield request.getfixturevalue("gateway")
        return
    async with LocalServer(engine_config=EngineConfig(playback_rate=FAST)) as server:
        yield server.address


@pytest.fixture
def server_credentials() -> None:
    """None: plain text."""


@pytest.fixture
def server_token() -> str:
    """No token: these servers do not authenticate callers."""
    return ""
