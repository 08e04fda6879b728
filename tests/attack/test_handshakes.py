"""Many TLS clients at once that disconnect after their handshake."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path

from tests.attack.server import attacked
from tests.server.identity.files import AUTHORITY, copy_pair
from tests.waiting import LIMIT_S

AT_ONCE = 40
EACH = 60


async def shake_hands(address: str) -> int:
    """Connect again and again, `AT_ONCE` at a time. Returns the number of handshakes that succeeded."""
    host, _, port = address.rpartition(":")
    context = ssl.create_default_context(cafile=AUTHORITY)
    context.set_alpn_protocols(["h2"])

    async def one() -> int:
        for _ in range(EACH):
            _, writer = await asyncio.open_connection(host, int(port), ssl=context)
            writer.transport.abort()
        return EACH

    async with asyncio.timeout(LIMIT_S):
        return sum(await asyncio.gather(*(one() for _ in range(AT_ONCE))))


def test_server_survives_many_tls_handshakes_at_once(tmp_path: Path) -> None:
    certificate, key = copy_pair("server-1", tmp_path)
    with attacked(tmp_path / "log", ("--tls-certificate", certificate, "--tls-key", key)) as server:
        assert asyncio.run(shake_hands(server.address)) == AT_ONCE * EACH
    assert server.exit_code == 0
