"""Envoy with deploy/proxies/envoy.yaml: error answers of a server do not move clients to another server."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import grpc
import pytest
from grpc_health.v1 import health, health_pb2, health_pb2_grpc

from motiongen_client.channel import REPLICA_KEY
from tests.scale.proxies import CERTIFICATES, Behind, Envoy
from tests.waiting import LIMIT_S, until

pytestmark = pytest.mark.system
KEY = ((REPLICA_KEY, "0123456789abcdef"),)
WHO, FAIL, UNKNOWN = (f"/motiongen.test.Named/{name}" for name in ("Who", "Fail", "Unknown"))
FAILURES = (grpc.StatusCode.INTERNAL, grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.UNKNOWN)


class Named(grpc.GenericRpcHandler):
    """A server's methods: one returns its name, one fails with the status it is asked for."""

    def __init__(self, name: bytes) -> None:
        self._name = name

    def service(self, call: grpc.HandlerCallDetails) -> grpc.RpcMethodHandler | None:
        methods = {WHO: self._who, FAIL: self._fail}
        found = methods.get(call.method)
        return None if found is None else grpc.unary_unary_rpc_method_handler(found)

    def _who(self, _request: bytes, _context: grpc.ServicerContext) -> bytes:
        return self._name

    def _fail(self, request: bytes, context: grpc.ServicerContext) -> bytes:
        context.abort(grpc.StatusCode[request.decode()], "as it was told")
        return b""


@contextmanager
def serving(name: bytes) -> Iterator[tuple[grpc.Server, int]]:
    server = grpc.server(ThreadPoolExecutor(4), handlers=(Named(name),))
    checks = health.HealthServicer()
    checks.set("", health_pb2.HealthCheckResponse.SERVING)
    health_pb2_grpc.add_HealthServicer_to_server(checks, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        yield server, port
    finally:
        server.stop(None).wait()


@pytest.fixture
def servers() -> Iterator[dict[bytes, tuple[grpc.Server, int]]]:
    with ExitStack() as stack:
        yield {name: stack.enter_context(serving(name)) for name in (b"a", b"b")}


@pytest.fixture
def ask(servers: dict[bytes, tuple[grpc.Server, int]], tmp_path: Path) -> Iterator[Callable[[str, bytes], bytes]]:
    """A function that calls a method through Envoy, always with the same key. It raises grpc.RpcError."""
    credentials = grpc.ssl_channel_credentials((CERTIFICATES / "authority.pem").read_bytes())
    with (
        Envoy(tmp_path, [Behind(port, 0) for _, port in servers.values()]) as proxy,
        grpc.secure_channel(proxy.address, credentials) as channel,
    ):

        def call(method: str, request: bytes = b"") -> bytes:
            answer: bytes = channel.unary_unary(method)(request, metadata=KEY, timeout=LIMIT_S)
            return answer

        yield call


def who(ask: Callable[[str, bytes], bytes]) -> bytes:
    """The name of the server that the key leads to; empty while there is none."""
    try:
        return ask(WHO, b"")
    except grpc.RpcError:
        return b""


def test_error_answers_move_no_client_to_another_server(ask: Callable[[str, bytes], bytes]) -> None:
    mine = until(lambda: who(ask))
    for _ in range(30):
        for method, request in ((UNKNOWN, b""), *((FAIL, code.name.encode()) for code in FAILURES)):
            with pytest.raises(grpc.RpcError):
                ask(method, request)
            assert who(ask) == mine, f"moved to another server by a call of {method} with {request!r}"


def test_stopped_server_is_skipped(
    ask: Callable[[str, bytes], bytes], servers: dict[bytes, tuple[grpc.Server, int]]
) -> None:
    mine = until(lambda: who(ask))
    (other,) = set(servers) - {mine}
    servers[mine][0].stop(None).wait()
    until(lambda: who(ask) == other)
