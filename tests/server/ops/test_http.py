"""Health checks and metrics over HTTP."""

from __future__ import annotations

import httpx
import pytest
from prometheus_client import CollectorRegistry, Counter

from motiongen_server.ops.http import ops_app


@pytest.mark.parametrize(("path", "alive", "ready"), [("/livez", 1, 0), ("/healthz", 1, 0), ("/readyz", 0, 1)])
@pytest.mark.parametrize("well", [True, False])
async def test_each_check_answers_for_its_own_question(path: str, alive: int, ready: int, well: bool) -> None:
    answers = {"alive": well if alive else not well, "ready": well if ready else not well}
    app = ops_app(CollectorRegistry(), lambda: answers["alive"], lambda: answers["ready"])
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://ops") as client:
        response = await client.get(path)
    assert (response.status_code, response.text) == ((200, "ok\n") if well else (503, "not ok\n"))


async def test_metrics_are_prometheus_text_of_the_registry() -> None:
    registry = CollectorRegistry()
    Counter("motiongen_things", "Things.", registry=registry).inc(3)
    app = ops_app(registry, lambda: True, lambda: True)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://ops") as client:
        response = await client.get("/metrics")
        assert (await client.get("/nothing")).status_code == 404
    assert response.headers["content-type"].startswith("text/plain")
    assert "motiongen_things_total 3.0" in response.text
