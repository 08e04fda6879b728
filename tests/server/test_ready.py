"""motiongen-server-ready: the health check of containers, against a real operations port."""

from __future__ import annotations

import asyncio
import socket
import ssl

import pytest
from prometheus_client import CollectorRegistry

from motiongen_server.config import ServerConfig
from motiongen_server.ops.http import ops_app
from motiongen_server.ops.port import OpsPort
from motiongen_server.ready import main, readiness_url
from motiongen_server.settings import SettingError
from motiongen_server.text.encoder.config import EncoderConfig
from tests.scale.proxies import CERTIFICATES


async def exit_code(port: int, **environment: str) -> int:
    """The command's exit code, given the server's settings."""
    settings = {"MOTIONGEN_OPS_PORT": str(port), **environment}
    return await asyncio.to_thread(main, [], settings)


@pytest.mark.parametrize("ready", [True, False])
async def test_exit_code_follows_the_servers_readiness(ready: bool) -> None:
    port = OpsPort(ops_app(CollectorRegistry(), lambda: True, lambda: ready), "127.0.0.1", 0)
    await port.start()
    try:
        assert await exit_code(port.port) == (0 if ready else 1)
    finally:
        await port.stop()
    assert await exit_code(port.port) == 1, "the port is closed"


async def test_proxy_of_the_environment_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # bound, but not listening
        monkeypatch.setattr("urllib.request._opener", None)  # as in a process that has made no request before
        monkeypatch.setenv("http_proxy", f"http://127.0.0.1:{nobody.getsockname()[1]}")
        for name in ("no_proxy", "NO_PROXY"):
            monkeypatch.delenv(name, raising=False)
        port = OpsPort(ops_app(CollectorRegistry(), lambda: True, lambda: True), "127.0.0.1", 0)
        await port.start()
        try:
            assert await exit_code(port.port) == 0
        finally:
            await port.stop()


async def test_port_that_speaks_another_protocol_is_not_ready() -> None:
    async def answer(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"SSH-2.0\r\n\r\n")
        writer.close()

    async with await asyncio.start_server(answer, "127.0.0.1", 0) as other:
        assert await exit_code(other.sockets[0].getsockname()[1]) == 1


async def test_ops_port_with_tls_is_checked_over_https() -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    files = str(CERTIFICATES / "server-1.pem"), str(CERTIFICATES / "server-1.key")
    context.load_cert_chain(*files)
    port = OpsPort(ops_app(CollectorRegistry(), lambda: True, lambda: True), "127.0.0.1", 0, context)
    await port.start()
    tls = {"MOTIONGEN_OPS_TLS": "true", "MOTIONGEN_TLS_CERTIFICATE": files[0], "MOTIONGEN_TLS_KEY": files[1]}
    try:
        assert await exit_code(port.port, **tls) == 0
    finally:
        await port.stop()


def test_wildcard_address_is_checked_over_loopback() -> None:
    assert readiness_url(ServerConfig(ops_host="0.0.0.0", insecure=True)) == "http://127.0.0.1:9464/readyz"
    assert readiness_url(ServerConfig(ops_host="::", insecure=True)) == "http://[::1]:9464/readyz"
    assert readiness_url(ServerConfig(ops_host="10.1.2.3", insecure=True)) == "http://10.1.2.3:9464/readyz"
    assert readiness_url(EncoderConfig()) == "http://127.0.0.1:9465/readyz"


def test_unknown_port_is_refused() -> None:
    with pytest.raises(SettingError, match="ops_port is 0"):
        readiness_url(ServerConfig(ops_port=0))


def test_invalid_setting_exits_with_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([], {"MOTIONGEN_OPS_PORT": "none"}) == 2
    assert "ops_port is 'none'; it must be a whole number" in capsys.readouterr().err
    assert main(["--encoder"], {"MOTIONGEN_ENCODER_OPS_PORT": "none"}) == 2


def test_unresolvable_host_is_not_ready() -> None:
    assert main([], {"MOTIONGEN_OPS_HOST": "a..b", "MOTIONGEN_INSECURE": "true"}) == 1
