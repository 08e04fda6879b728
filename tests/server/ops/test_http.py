"""Health checks and metrics over HTTP."""

from __future__ import annotations

import asyncio
from functools import partial

import httpx
import pytest
from prometheus_client import CollectorRegistry, Counter
from prometheus_client.metrics_core import Metric

from motiongen_server.ops import http
from motiongen_server.ops.http import ops_app
from tests.server.ops.serving import serving
from tests.waiting import until_true


@pytest.mark.parametrize(("path", "alive", "ready"), [("/livez", 1, 0), ("/healthz", 1, 0), ("/readyz", 0, 1)])
@pytest.mark.parametrize("well", [True, False])
async def test_each_check_answers_its_own_question(path: str, alive: int, ready: int, well: bool) -> None:
    answers = {"alive": well if alive else not well, "ready": well if ready else not well}
    app = ops_app(CollectorRegistry(), lambda: answers["alive"], lambda: answers["ready"])
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://ops") as client:
        response = await client.get(path)
    assert (response.status_code, response.text) == ((200, "ok\n") if well else (503, "not ok\n"))


async def test_metrics_are_the_registry_in_prometheus_text_format() -> None:
    registry = CollectorRegistry()
    Counter("motiongen_things", "Things.", registry=registry).inc(3)
    app = ops_app(registry, lambda: True, lambda: True)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://ops") as client:
        response = await client.get("/metrics")
        assert (await client.get("/nothing")).status_code == 404
    assert response.headers["content-type"].startswith("text/plain")
    assert "motiongen_things_total 3.0" in response.text


async def test_request_with_two_tokens_is_refused() -> None:
    def refusal_of(authorization: str) -> str | None:
        return None if authorization == "Bearer mine" else "no"

    app = ops_app(CollectorRegistry(), lambda: True, lambda: True, refusal_of)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://ops") as client:
        for times, status in ((1, 200), (2, 401)):
            answer = await client.get("/metrics", headers=[("Authorization", "Bearer mine")] * times)
            assert answer.status_code == status


async def test_old_connections_are_closed_when_there_are_too_many_or_at_the_age_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(http, "MOST_CONNECTIONS", 2)
    async with serving() as port:
        first, *others = [await asyncio.open_connection("127.0.0.1", port) for _ in range(3)]
        assert await end_of(first[0]), "the oldest goes"
        monkeypatch.setattr(http, "LIFE_S", 0.05)
        late = await asyncio.open_connection("127.0.0.1", port)
        assert await end_of(late[0])
        for _, writer in (first, *others, late):
            writer.transport.abort()


async def test_malformed_requests_are_not_logged_and_faults_are(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")

    def fault() -> bool:
        raise RuntimeError("a fault")

    upgrade = b"GET /readyz HTTP/1.1\r\nHost: ops\r\nConnection: upgrade\r\nUpgrade: websocket\r\n\r\n"

    async def answer(port: int, request: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(request)
        try:
            return await reader.readline()
        finally:
            writer.transport.abort()

    async with serving(is_alive=fault) as port:
        assert b"400" in await answer(port, b"garbage\r\n\r\n")
        assert b"200" in await answer(port, upgrade)
        for method in (b"GET", b"HEAD"):  # with a malformed chunked body
            chunked = b" /readyz HTTP/1.1\r\nHost: ops\r\nTransfer-Encoding: chunked\r\n\r\nno length\r\n"
            await answer(port, method + chunked)
        await until_true(lambda: not http.BoundedConnection.open_ones)
        assert not [record for record in caplog.records if record.levelname != "INFO"]
        assert b"500" in await answer(port, b"GET /livez HTTP/1.1\r\nHost: ops\r\n\r\n")
        (logged,) = [record for record in caplog.records if record.name.startswith("uvicorn")]
        assert logged.levelname == "ERROR"
        await until_true(lambda: not http.BoundedConnection.open_ones)
        assert not [record for record in caplog.records if record.name == "asyncio"], (
            "nor is the end of a connection logged"
        )


async def test_metrics_are_rendered_a_few_times_a_second_however_often_requested(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Counted:
        times = 0

        def collect(self) -> list[Metric]:
            self.times += 1
            return []

    now = [0.0]
    monkeypatch.setattr(http, "Pace", partial(http.Pace, clock=lambda: now[0]))
    registry, counted = CollectorRegistry(), Counted()
    registry.register(counted)  # type: ignore[arg-type]
    counted.times = 0
    app = ops_app(registry, lambda: True, lambda: True)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://ops") as client:
        for second in (1, 2):
            answers = await asyncio.gather(*(client.get("/metrics") for _ in range(50)))
            assert {answer.status_code for answer in answers} == {200}
            assert counted.times == second * http.RENDERINGS_A_SECOND
            now[0] = second


async def test_connection_is_answered_only_once() -> None:
    async with serving() as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n" * 10)
        assert (await reader.read()).count(b"HTTP/1.1 200") == 1
        writer.transport.abort()


async def end_of(reader: asyncio.StreamReader) -> bool:
    """Wait for the end of the connection; False if something else came."""
    try:
        return await reader.read() == b""
    except ConnectionResetError:
        return True
