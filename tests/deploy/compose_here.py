"""The services of deploy/compose.yaml as processes on this machine, with their settings, on other ports."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import yaml

from tests.deploy.dashboard import REPOSITORY
from tests.scale.proxies import free_port, kill_with_children
from tests.waiting import until

DEPLOY = REPOSITORY / "deploy"
SERVERS = ("server-a", "server-b")
SMALL = {"MOTIONGEN_DEVICES": "cpu:1", "MOTIONGEN_PROFILE_S": "1", "MOTIONGEN_ADMIT_LOAD": "100"}
"""Settings for a machine that also does other work."""
IMAGE = {"MOTIONGEN_HOST": "0.0.0.0", "MOTIONGEN_OPS_HOST": "0.0.0.0"}
"""The environment that deploy/Dockerfile sets."""


def read_compose() -> dict[str, Any]:
    """deploy/compose.yaml, with shared parts inserted into each service."""
    return dict(yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8")))


def mounted(service: dict[str, Any]) -> dict[str, Path]:
    """The files of this repository that a service mounts, by their paths in the container."""
    pairs = (volume.split(":") for volume in service.get("volumes", ()) if volume.startswith("./"))
    return {target: DEPLOY / source for source, target, *_ in pairs}


def make_secrets(folder: Path) -> Path:
    """Run deploy/make_secrets.sh, with tokens from the real server."""
    made = folder / "secrets"
    environment = {**os.environ, "IDENTITY": f"{sys.executable} -m motiongen_server.identity"}
    subprocess.run([str(DEPLOY / "make_secrets.sh"), str(made)], check=True, env=environment, capture_output=True)
    return made


class ComposeHere:
    """Use as `with ComposeHere(folder) as here`: the services run, and the servers are ready."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.services = read_compose()["services"]
        self.secrets = make_secrets(folder)
        self.port = {name: free_port() for name in self.services}
        self.ops_port = {name: free_port() for name in (*SERVERS, "encoder")}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> ComposeHere:
        try:
            self._start_redis()
            self._start_program("encoder", "motiongen_server.text.encoder", self._encoder_settings())
            until(lambda: self.is_ready("encoder"))
            for name in SERVERS:
                self._start_program(name, "motiongen_server", self.server_settings(name))
            for name in SERVERS:
                until(lambda name=name: self.is_ready(name))  # type: ignore[misc]
            self._start_proxy()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for process in reversed(self._processes.values()):
            process.terminate()
        for process in reversed(self._processes.values()):
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                kill_with_children(process)

    # ---- settings ---------------------------------------------------------------------------------------------------

    def here(self, text: str) -> str:
        """A text of the compose file, with paths and addresses replaced by those on this machine."""
        text = text.replace("/run/secrets/", f"{self.secrets}/")
        text = text.replace("encoder:50052", f"localhost:{self.port['encoder']}")
        text = text.replace("encoder:9465", f"localhost:{self.ops_port['encoder']}")
        return text.replace("@redis:6379", f"@localhost:{self.port['redis']}")

    def server_settings(self, name: str) -> dict[str, str]:
        """The environment of a server: that of the image, of the compose file, and its files."""
        service = self.services[name]
        given = {key: self.here(value) for key, value in service["environment"].items()}
        for file in service["env_file"]:
            lines = (self.secrets / Path(file).name).read_text(encoding="utf-8").split()
            given |= {key: self.here(value) for key, value in (line.split("=", 1) for line in lines)}
        ports = {"MOTIONGEN_PORT": str(self.port[name]), "MOTIONGEN_OPS_PORT": str(self.ops_port[name])}
        return IMAGE | given | ports | SMALL

    def _encoder_settings(self) -> dict[str, str]:
        given = {key: self.here(value) for key, value in self.services["encoder"]["environment"].items()}
        prefix = "MOTIONGEN_ENCODER_"
        ports = {f"{prefix}PORT": str(self.port["encoder"]), f"{prefix}OPS_PORT": str(self.ops_port["encoder"])}
        return IMAGE | given | ports

    # ---- processes --------------------------------------------------------------------------------------------------

    def _run(self, name: str, command: list[str], environment: dict[str, str] | None = None) -> None:
        with (self._folder / f"{name}.log").open("ab") as log:
            self._processes[name] = subprocess.Popen(command, stdout=log, stderr=log, env=environment)

    def log(self, name: str) -> str:
        """The log of a service."""
        return (self._folder / f"{name}.log").read_text(errors="replace")

    def _check_runs(self, name: str) -> None:
        if self._processes[name].poll() is not None:
            raise RuntimeError(f"{name} has ended: {self.log(name)[-2000:]}")

    def _start_program(self, name: str, module: str, settings: dict[str, str]) -> None:
        others = {key: value for key, value in os.environ.items() if not key.startswith("MOTIONGEN_")}
        self._run(name, [sys.executable, "-m", module], others | settings)

    def is_ready(self, name: str) -> bool:
        """The result of its health check command."""
        self._check_runs(name)
        return self.status(name, "/readyz") == 200

    def status(self, name: str, path: str, token: str = "") -> int:
        """The HTTP status of a path on its operations port; 0 without an answer."""
        url = f"http://localhost:{self.ops_port[name]}{path}"
        header = {"Authorization": f"Bearer {token}"} if token else {}
        try:
            with urllib.request.urlopen(urllib.request.Request(url, headers=header), timeout=5) as answer:
                return int(answer.status)
        except urllib.error.HTTPError as refused:
            with refused:
                return refused.code
        except OSError:
            return 0

    def _start_redis(self) -> None:
        assert shutil.which("redis-server"), "redis-server is not installed (apt-get install redis-server)"
        *shell, line = self.services["redis"]["command"]
        line = f"{self.here(line.replace('$$', '$'))} --port {self.port['redis']} --dir {self._folder}"
        self._run("redis", [*shell, line])
        self._wait_for("redis")

    def _start_proxy(self) -> None:
        assert shutil.which("haproxy"), "haproxy is not installed (apt-get install haproxy)"
        *shell, line = self.services["proxy"]["command"]
        made = self._folder / "haproxy.cfg"
        making, running = self.here(line).replace("/dev/shm/haproxy.cfg", str(made)).split(" && exec ")
        source = {name: str(here) for name, here in mounted(self.services["proxy"]).items()}
        making = making.replace("/etc/haproxy/motiongen.cfg", source["/etc/haproxy/motiongen.cfg"])
        subprocess.run([*shell, making], check=True)
        text = made.read_text(encoding="utf-8").replace("bind :50051", f"bind 127.0.0.1:{self.port['proxy']}")
        text = text.replace("/etc/haproxy/motiongen.pem", str(self.secrets / "proxy-with-key.pem"))
        for name in SERVERS:
            assert f"{name}:50051" in text
            theirs = f"localhost:{self.port[name]} check port {self.ops_port[name]}"
            text = text.replace(f"{name}:50051", theirs)
        made.write_text(text, encoding="utf-8")
        resolvers = "/etc/haproxy/resolvers.cfg"
        self._run("proxy", running.replace(resolvers, source[resolvers]).split())
        self._wait_for("proxy")

    def _wait_for(self, name: str) -> None:
        def listens() -> bool:
            self._check_runs(name)
            try:
                socket.create_connection(("localhost", self.port[name]), timeout=1).close()
            except OSError:
                return False
            return True

        until(listens)
