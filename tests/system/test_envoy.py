"""Envoy with deploy/proxies/envoy.yaml: what a server answers to one client sends no other client elsewhere."""

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
    """A server's methods: one says its name, one fails as it is told."""

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
    """Calls a method through Envoy, always by the same key. Raises grpc.RpcError."""
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
    """The name of the server that the key leads to; none while there is none."""
    try:
        return ask(WHO, b"")
    except grpc.RpcError:
        return b""


def test_what_a_server_answers_turns_nobody_away_from_it(ask: Callable[[str, bytes], bytes]) -> None:
    mine = until(lambda: who(ask))
    for _ in range(30):
        for method, request in ((UNKNOWN, b""), *((FAIL, code.name.encode()) for code in FAILURES)):
            with pytest.raises(grpc.RpcError):
                ask(method, request)
            assert who(ask) == mine, f"sent elsewhere since a call of {method} was answered with {request!r}"


def test_a_server_that_is_gone_is_passed_over(
    ask: Callable[[str, bytes], bytes], servers: dict[bytes, tuple[grpc.Server, int]]
) -> None:
    mine = until(lambda: who(ask))
    (other,) = set(servers) - {mine}
    servers[mine][0].stop(None).wait()
    until(lambda: who(ask) == other)
