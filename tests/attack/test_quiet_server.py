"""The log of a server under attack contains nothing that clients sent, as with a server in use."""

from __future__ import annotations

import asyncio
from pathlib import Path

from tests.attack.server import attacked
from tests.raw_calls import answer_to


async def test_headers_that_grpc_cannot_read_are_not_logged(tmp_path: Path) -> None:
    with attacked(tmp_path / "log") as server:
        port = int(server.address.rpartition(":")[2])
        await asyncio.to_thread(answer_to, port, b"/nobody.Serves/This", (b"grpc-timeout", b"soon"))
    assert "grpc-timeout" not in server.log.read_text(encoding="utf-8")
