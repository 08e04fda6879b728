"""The services of deploy/compose.yaml, started on this machine, and a client that uses them all."""

from __future__ import annotations

import subprocess
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import grpc
import pytest
import yaml

from motiongen_client import MotionClient
from motiongen_client.errors import MotiongenError
from tests.deploy.compose_here import DEPLOY, SERVERS, ComposeHere
from tests.deploy.watched_servers import Prometheus

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]
FRAMES = 40


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ComposeHere]:
    with ComposeHere(tmp_path_factory.mktemp("compose")) as running:
        yield running


@pytest.fixture
async def client(here: ComposeHere) -> AsyncIterator[MotionClient]:
    credentials = grpc.ssl_channel_credentials((here.secrets / "authority.pem").read_bytes())
    token = (here.secrets / "player.token").read_text(encoding="utf-8").strip()
    async with MotionClient(f"localhost:{here.port['proxy']}", credentials=credentials, token=token) as connected:
        yield connected


async def test_client_plays_through_proxy_server_encoder_and_store(here: ComposeHere, client: MotionClient) -> None:
    """The prompt is new, so the encoder has to encode it; durable_seq shows that the store has the session."""
    session = await client.open("a person stumbles over a cable and catches himself")
    shown = 0
    async for _ in session.frames():
        shown += 1
        if shown == FRAMES:
            break
    assert session.durable_seq > 0
    await session.close()


async def test_client_without_a_token_is_refused(here: ComposeHere) -> None:
    credentials = grpc.ssl_channel_credentials((here.secrets / "authority.pem").read_bytes())
    with pytest.raises(MotiongenError, match="CREDENTIALS_MISSING"):
        async with MotionClient(f"localhost:{here.port['proxy']}", credentials=credentials) as stranger:
            await stranger.open("a person walks")


@pytest.mark.parametrize("name", [*SERVERS, "encoder"])
def test_metrics_are_served_only_to_prometheus(here: ComposeHere, name: str) -> None:
    files = {who: here.secrets / f"{who}.token" for who in ("prometheus", "player")}
    tokens = {who: file.read_text(encoding="utf-8").strip() for who, file in files.items()}
    assert here.status(name, "/metrics", tokens["prometheus"]) == 200
    assert here.status(name, "/metrics", tokens["player"]) == 401
    assert here.status(name, "/metrics") == 401


def test_prometheus_reads_both_servers_and_the_encoder(here: ComposeHere, tmp_path: Path) -> None:
    configuration = tmp_path / "compose.yaml"
    configuration.write_text(here.here((DEPLOY / "prometheus" / "compose.yaml").read_text(encoding="utf-8")))
    with Prometheus(tmp_path, [here.ops_port[name] for name in SERVERS], configuration=configuration) as prometheus:
        assert len(prometheus.query("motiongen_build_info")) == 2
        assert len(prometheus.query('motiongen_encoder_waiting{job="encoder"}')) == 1


def test_prometheus_accepts_the_flags_of_its_command(here: ComposeHere) -> None:
    """It checks flags before it reads its configuration."""
    command = [*here.services["prometheus"]["command"], "--version"]
    done = subprocess.run(["prometheus", *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_logs_contain_no_token(here: ComposeHere) -> None:
    secrets = [(here.secrets / name).read_text(encoding="utf-8").strip() for name in ("player.token", "servers.token")]
    for name in (*SERVERS, "encoder", "proxy"):
        assert not any(secret in here.log(name) for secret in secrets), name


def test_rule_files_of_prometheus_exist() -> None:
    content = yaml.safe_load((DEPLOY / "prometheus" / "compose.yaml").read_text(encoding="utf-8"))
    assert all((DEPLOY / "prometheus" / name).exists() for name in content["rule_files"])
