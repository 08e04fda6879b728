"""The images of deploy/Dockerfile: a server in them serves, not as root and on a read-only file system."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from motiongen_client import MotionClient
from tests.deploy.compose_here import make_secrets
from tests.deploy.images import Images, Mounted, tell
from tests.scale.proxies import free_port
from tests.waiting import until

pytestmark = [pytest.mark.system, pytest.mark.timeout(3600)]
FRAMES = 40
WEIGHTS = ("*.safetensors", "*.bin", "*.pt", "*.gguf", "*.onnx")
TLS = {
    "MOTIONGEN_TLS_CERTIFICATE": "/run/secrets/server.pem",
    "MOTIONGEN_TLS_KEY": "/run/secrets/server.key",
    "MOTIONGEN_TENANTS": "/run/secrets/tenants.toml",
    "MOTIONGEN_OPS_TLS": "true",
}


@pytest.fixture(scope="module")
def images() -> Images:
    return Images()


@pytest.fixture(scope="module")
def cpu(images: Images) -> Iterator[Mounted]:
    """The image for processors; pip's usual index gives it the torch that also supports GPUs."""
    with images.mounted(images.build("cpu")) as image:
        yield image


@pytest.fixture(scope="module")
def cuda(images: Images) -> Iterator[Mounted]:
    with images.mounted(images.build("cuda")) as image:
        yield image


class Serving:
    """A server in the image, with TLS, tokens and ports of this machine."""

    def __init__(self, image: Mounted, folder: Path) -> None:
        self.secrets = make_secrets(folder)
        self.port, ops_port = free_port(), free_port()
        ports = {"MOTIONGEN_PORT": str(self.port), "MOTIONGEN_OPS_PORT": str(ops_port)}
        self.settings = TLS | ports | {"MOTIONGEN_DEVICES": "cpu:1", "MOTIONGEN_PROFILE_S": "1"}
        self.image = image
        self.process = image.start((), self.settings, self.secrets)

    def is_ready(self) -> bool:
        """Whether the image's own health check succeeds."""
        if self.process.poll() is not None:
            assert self.process.stdout is not None
            raise RuntimeError(f"the server has ended: {self.process.stdout.read()[-3000:]}")
        kind, *command = self.image.config["Healthcheck"]["Test"]
        assert kind == "CMD"
        checking = self.image.start(command, self.settings, self.secrets)
        with checking:
            checking.communicate()
        return checking.returncode == 0


@pytest.fixture(scope="module")
def serving(cpu: Mounted, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    server = Serving(cpu, tmp_path_factory.mktemp("serving"))
    try:
        until(server.is_ready)
        yield server
    finally:
        if server.process.poll() is None:
            tell(server.process, signal.SIGKILL)
        server.process.communicate()


async def test_client_plays_what_a_server_in_the_image_generates(serving: Serving) -> None:
    authority = (serving.secrets / "authority.pem").read_bytes()
    credentials = grpc.ssl_channel_credentials(authority)
    token = (serving.secrets / "player.token").read_text(encoding="utf-8").strip()
    async with MotionClient(f"localhost:{serving.port}", credentials=credentials, token=token) as client:
        session = await client.open("a person walks forward")
        shown = 0
        async for _ in session.frames():
            shown += 1
            if shown == FRAMES:
                break
        await session.close()
    with grpc.secure_channel(f"localhost:{serving.port}", credentials) as channel:
        answer = health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest(), timeout=10)
    assert answer.status == health_pb2.HealthCheckResponse.SERVING


def test_server_runs_without_rights_on_a_read_only_root(serving: Serving, cpu: Mounted) -> None:
    assert cpu.config["User"] == "10001"
    pids = Path(f"/proc/{serving.process.pid}/task/{serving.process.pid}/children").read_text().split()
    status = dict(
        line.split(":\t", 1) for line in Path(f"/proc/{pids[0]}/status").read_text().splitlines() if ":\t" in line
    )
    assert set(status["Uid"].split()) == set(status["Gid"].split()) == {"10001"}
    assert int(status["CapEff"], 16) == int(status["CapBnd"], 16) == 0
    assert status["NoNewPrivs"].strip() == "1"
    code, said = cpu.run(["sh", "-c", "cd / && touch tmp/here && ! touch here && ! touch opt/motiongen/here"])
    assert code == 0, said
    assert said.count("Read-only file system") == 2


def test_sigterm_drains_and_ends_the_server_with_code_0(cpu: Mounted, tmp_path: Path) -> None:
    server = Serving(cpu, tmp_path)
    until(server.is_ready)
    tell(server.process, signal.SIGTERM)
    said, _ = server.process.communicate()
    assert server.process.returncode == 0, said
    assert '"draining"' in said
    assert cpu.config["StopSignal"] == "SIGTERM"


def test_server_does_not_start_on_a_public_address_without_protection(cpu: Mounted) -> None:
    code, said = cpu.run()
    assert code == 2
    assert "without TLS" in said


def test_image_contains_no_weights_but_the_built_in_ones(cpu: Mounted) -> None:
    found = {path for pattern in WEIGHTS for path in (cpu.root / "opt").rglob(pattern)}
    assert found
    assert {path for path in found if "/motiongen_ardy/" not in str(path)} == set()


def test_image_contains_no_build_files_or_compilers(cpu: Mounted) -> None:
    assert not (cpu.root / "src").exists()
    assert not (cpu.root / "pip").exists()
    assert subprocess.run(["find", str(cpu.root / "usr" / "bin"), "-name", "gcc*"], capture_output=True).stdout == b""


def test_image_for_gpus_needs_a_gpu(cuda: Mounted) -> None:
    """On this machine, without a GPU, it ends with a message."""
    assert "MOTIONGEN_DEVICES=cuda:all" in cuda.config["Env"]
    assert "NVIDIA_DRIVER_CAPABILITIES=compute,utility" in cuda.config["Env"]
    code, said = cuda.run((), {"MOTIONGEN_INSECURE": "true"})
    assert code == 2
    assert "CUDA" in said
