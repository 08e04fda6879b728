"""Fetching keys over HTTP, also from servers that answer slowly, without end, or with nonsense."""

from __future__ import annotations

import contextlib
import socket
import ssl
import threading
from collections.abc import Callable, Iterator

import pytest

from motiongen_server.identity.issuers import DISCOVERY, KeySource
from motiongen_server.identity.key_fetch import MOST_BYTES, fetched
from tests.server.identity.files import AUTHORITY, CERTIFICATES
from tests.server.identity.issuer import Issuer

HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n"


@contextlib.contextmanager
def answering(answer: Callable[[socket.socket], None]) -> Iterator[tuple[int, list[str]]]:
    """A server that passes its connections to `answer`, one after the other. Gives its port and the request lines."""
    heard: list[str] = []

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                line, _ = server.accept()
                with line, contextlib.suppress(OSError):
                    heard.append(line.recv(4096).decode(errors="replace").partition("\r\n")[0])
                    answer(line)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield server.getsockname()[1], heard
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join()


def test_keys_are_fetched_directly_and_by_discovery() -> None:
    issuer = Issuer(first="ES256")
    with issuer.served():
        assert list(fetched(KeySource(f"{issuer.url}/jwks"))) == ["first"]
        assert list(fetched(KeySource(issuer.url + DISCOVERY, is_discovery=True))) == ["first"]
        issuer.is_down = True
        with pytest.raises(ValueError, match="503"):
            fetched(KeySource(f"{issuer.url}/jwks"))
    with pytest.raises(ValueError, match="refused"):
        fetched(KeySource(f"{issuer.url}/jwks"))


def test_https_servers_must_present_a_trusted_certificate() -> None:
    issuer = Issuer(first="ES256")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(CERTIFICATES / "server-1.pem", CERTIFICATES / "server-1.key")
    with issuer.served(context):
        assert list(fetched(KeySource(f"{issuer.url}/jwks", authority=AUTHORITY))) == ["first"]
        for authority in ("", str(CERTIFICATES / "stranger-authority.pem")):
            with pytest.raises(ValueError, match="CERTIFICATE_VERIFY_FAILED"):
                fetched(KeySource(f"{issuer.url}/jwks", authority=authority))


@pytest.mark.parametrize("begun", [HEAD + b"Content-Length: 100000\r\n\r\n", HEAD + b"X-More: "], ids=["body", "head"])
def test_server_that_drips_bytes_misses_the_deadline(begun: bytes) -> None:
    def drip(line: socket.socket) -> None:
        line.sendall(begun)
        pause = threading.Event()
        while True:  # until the connection is closed
            line.sendall(b" ")
            pause.wait(0.01)

    with answering(drip) as (port, _), pytest.raises(ValueError, match=r"does not answer.*time"):
        fetched(KeySource(f"http://127.0.0.1:{port}/jwks"), within_s=0.1)


def test_answer_larger_than_the_limit_is_refused() -> None:
    def flood(line: socket.socket) -> None:
        line.sendall(HEAD + b"\r\n[")
        while True:
            line.sendall(b"0," * 65_536)

    with answering(flood) as (port, _), pytest.raises(ValueError, match=f"more than {MOST_BYTES} bytes"):
        fetched(KeySource(f"http://127.0.0.1:{port}/jwks"))


@pytest.mark.parametrize(
    "answer",
    [
        HEAD + b"\r\n[]",
        HEAD + b'\r\n"keys"',
        HEAD + b"\r\n" + b"[" * 100_000,
        HEAD + b"Content-Length: 9\r\n\r\n{",
        HEAD + b"Transfer-Encoding: chunked\r\n\r\n9\r\n{",
        HEAD + b"\r\n\xff\xfe\xff",
        b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:9/\r\n\r\n",
        b"no HTTP",
        b"",
    ],
)
@pytest.mark.parametrize("is_discovery", [False, True])
def test_unusable_answer_fails_the_fetch(answer: bytes, is_discovery: bool) -> None:
    with (
        answering(lambda line: line.sendall(answer)) as (port, _),
        pytest.raises(ValueError, match=f"http://127.0.0.1:{port}/jwks.*answer"),
    ):
        fetched(KeySource(f"http://127.0.0.1:{port}/jwks", is_discovery=is_discovery))


@pytest.mark.parametrize("named", ["http://login.example/jwks", "https://me:hush@login.example/jwks"])
def test_key_address_from_discovery_must_be_https_without_a_password(named: str) -> None:
    answer = HEAD + b'\r\n{"jwks_uri": "%s"}' % named.encode()
    with (
        answering(lambda line: line.sendall(answer)) as (port, _),
        pytest.raises(ValueError, match=r"jwks_uri of http://127.0.0.1.*(only by https|has a name or a password)"),
    ):
        fetched(KeySource(f"http://127.0.0.1:{port}/jwks", is_discovery=True))


def test_environment_proxy_is_used_only_for_https_to_other_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("no_proxy", "NO_PROXY", "HTTP_PROXY", "HTTPS_PROXY"):
        monkeypatch.delenv(name, raising=False)
    issuer = Issuer(first="ES256")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(CERTIFICATES / "server-1.pem", CERTIFICATES / "server-1.key")
    with answering(lambda line: line.sendall(b"HTTP/1.1 403 Forbidden\r\n\r\n")) as (port, heard):
        monkeypatch.setenv("http_proxy", f"http://127.0.0.1:{port}")
        monkeypatch.setenv("https_proxy", f"http://user:word@127.0.0.1:{port}")
        with issuer.served():
            assert list(fetched(KeySource(f"{issuer.url}/jwks"))) == ["first"]
        with issuer.served(context):
            assert list(fetched(KeySource(f"{issuer.url}/jwks", authority=AUTHORITY))) == ["first"]
        assert heard == []
        with pytest.raises(ValueError, match="403"):
            fetched(KeySource("https://login.example/jwks"))
        assert heard == ["CONNECT login.example:443 HTTP/1.0"]
