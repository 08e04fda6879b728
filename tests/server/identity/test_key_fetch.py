"""Fetching keys over HTTP: from real servers, also from those that answer slowly, too much, or nonsense."""

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
    """A server of one connection after another, which does with each as the test says: its port, and what it heard."""
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


def test_they_are_fetched_from_a_real_server_also_by_discovery() -> None:
    issuer = Issuer(first="ES256")
    with issuer.served():
        assert list(fetched(KeySource(f"{issuer.url}/jwks"))) == ["first"]
        assert list(fetched(KeySource(issuer.url + DISCOVERY, is_discovery=True))) == ["first"]
        issuer.is_down = True
        with pytest.raises(ValueError, match="503"):
            fetched(KeySource(f"{issuer.url}/jwks"))
    with pytest.raises(ValueError, match="refused"):
        fetched(KeySource(f"{issuer.url}/jwks"))


def test_by_https_they_come_only_from_who_proves_itself() -> None:
    issuer = Issuer(first="ES256")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(CERTIFICATES / "server-1.pem", CERTIFICATES / "server-1.key")
    with issuer.served(context):
        assert list(fetched(KeySource(f"{issuer.url}/jwks", authority=AUTHORITY))) == ["first"]
        for authority in ("", str(CERTIFICATES / "stranger-authority.pem")):
            with pytest.raises(ValueError, match="CERTIFICATE_VERIFY_FAILED"):
                fetched(KeySource(f"{issuer.url}/jwks", authority=authority))


@pytest.mark.parametrize("begun", [HEAD + b"Content-Length: 100000\r\n\r\n", HEAD + b"X-More: "], ids=["body", "head"])
def test_a_server_that_sends_a_byte_at_a_time_is_left_in_the_end(begun: bytes) -> None:
    def drip(line: socket.socket) -> None:
        line.sendall(begun)
        pause = threading.Event()
        while True:  # until the line is cut
            line.sendall(b" ")
            pause.wait(0.01)

    with answering(drip) as (port, _), pytest.raises(ValueError, match=r"does not answer.*time"):
        fetched(KeySource(f"http://127.0.0.1:{port}/jwks"), within_s=0.1)


def test_no_more_is_read_than_keys_may_have() -> None:
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
def test_an_answer_that_is_none_is_a_fetch_that_failed(answer: bytes, is_discovery: bool) -> None:
    with (
        answering(lambda line: line.sendall(answer)) as (port, _),
        pytest.raises(ValueError, match=f"http://127.0.0.1:{port}/jwks.*answer"),
    ):
        fetched(KeySource(f"http://127.0.0.1:{port}/jwks", is_discovery=is_discovery))


@pytest.mark.parametrize("named", ["http://login.example/jwks", "https://me:hush@login.example/jwks"])
def test_keys_that_discovery_finds_come_by_a_way_on_which_nobody_can_change_them(named: str) -> None:
    answer = HEAD + b'\r\n{"jwks_uri": "%s"}' % named.encode()
    with (
        answering(lambda line: line.sendall(answer)) as (port, _),
        pytest.raises(ValueError, match=r"jwks_uri of http://127.0.0.1.*(only by https|has a name or a password)"),
    ):
        fetched(KeySource(f"http://127.0.0.1:{port}/jwks", is_discovery=True))


def test_a_proxy_of_the_environment_sees_nothing_but_where_https_goes(monkeypatch: pytest.MonkeyPatch) -> None:
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
