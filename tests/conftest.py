"""Shared by tests of several packages: a real server process with a tiny model."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.server_process import ready

# how fast an example runs depends on the machine
settings.register_profile("motiongen", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("motiongen")

ROOT = Path(__file__).resolve().parents[1]
TINY_MODEL = ROOT / "tests" / "data" / "golden" / "tiny-core27" / "checkpoint"


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give each process whole files, and one process all tests of a folder that share a build."""
    from tests.scheduling import FileScheduling

    return FileScheduling(config, log)


@dataclass(frozen=True)
class LiveServer:
    """A server on free ports of this machine. address: for gRPC; ops_url: for health checks and metrics."""

    process: subprocess.Popen[str]
    address: str
    ops_url: str


@pytest.fixture(scope="session", autouse=True)
def state_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let the tests' servers keep their state in a folder of the tests, not in the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="session")
def live_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    """One server for all tests that use it; a test that stops or breaks a server starts its own. Its end is checked."""
    log = tmp_path_factory.mktemp("live_server") / "stderr.txt"
    settings = ["--port", "0", "--ops-port", "0", "--print-ports", "--devices", "cpu:1", "--drain-wait-s", "0"]
    settings += ["--playback-rate", "1000"]  # tests take motion faster than real time
    settings += ["--profile-s", "0.3", "--admit-load", "1000", "--degrade", "false"]  # on a busy machine, too
    settings += ["--peer-calls-per-second", "1e6"]  # all tests call from one address, some ten thousand times
    model = ["--model", str(TINY_MODEL), "--text-encoder", "hashed"]
    with log.open("w", encoding="utf-8") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "motiongen_server", *settings, *model],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )
    with ready(process, log) as ports:
        address, ops = f"localhost:{ports['grpc_port']}", f"http://localhost:{ports['ops_port']}"
        yield LiveServer(process, address, ops)
    assert process.returncode == 0, log.read_text()
