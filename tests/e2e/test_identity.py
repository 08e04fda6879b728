"""The service and the client over TLS, with tokens that are valid, invalid, or expire."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from motiongen_client import MotionClient, NotAllowed, StreamLost
from motiongen_server.identity.tls import ServerTls, TlsFiles
from motiongen_server.identity.tokens import new_token
from motiongen_tools import cli
from tests.contract.local import LocalServer
from tests.e2e.lost_line import FACTS_AS_SERVED
from tests.server.identity.files import AUTHORITY, TenantsFile, client_credentials, copy_pair
from tests.waiting import LIMIT_S, until_true

EXPIRES, EXPIRES_AT = "2027-01-15T08:01:00Z", 1_800_000_060.0


@pytest.fixture
def tenants(tmp_path: Path) -> TenantsFile:
    return TenantsFile(tmp_path)


def served(tenants: TenantsFile, tls: ServerTls | None = None) -> LocalServer:
    return LocalServer(facts=FACTS_AS_SERVED, callers=tenants.callers(), tls=tls)


async def play(client: MotionClient) -> None:
    session = await client.open("a person walks")
    async for _ in session.frames(seconds=1):
        pass


async def test_token_is_sent_with_every_call_over_tls(tenants: TenantsFile, tmp_path: Path) -> None:
    token = tenants.one()
    tls = ServerTls(TlsFiles(*copy_pair("server-1", tmp_path), AUTHORITY))
    async with (
        asyncio.timeout(LIMIT_S),
        served(tenants, tls) as server,
        MotionClient(server.address, credentials=client_credentials("client"), token=token) as client,
    ):
        await play(client)
        assert len(await client.generate_clip("a person walks", num_frames=8)) == 1


async def test_refused_client_gets_the_reason_at_once(tenants: TenantsFile) -> None:
    token = tenants.one("roles = ['metrics']")
    async with asyncio.timeout(LIMIT_S), served(tenants) as server:
        for given, reason in (
            (None, "CREDENTIALS_MISSING"),
            (new_token()[0], "CREDENTIALS_INVALID"),
            (token, "ROLE_MISSING"),
        ):
            with pytest.raises(NotAllowed) as refused:
                await MotionClient(server.address, token=given).connect()
            assert (refused.value.reason, refused.value.address) == (reason, server.address)


async def test_session_continues_with_a_next_token_after_its_token_expires(tenants: TenantsFile) -> None:
    (old, old_hash), (new, new_hash) = new_token(), new_token()
    tenants.write(f"[tenants.a]\ntokens = [{{ hash = '{old_hash}', expires = {EXPIRES} }}, {{ hash = '{new_hash}' }}]")
    tokens = [old]
    async with (
        asyncio.timeout(LIMIT_S),
        served(tenants) as server,
        MotionClient(server.address, token=lambda: tokens[-1]) as client,
    ):
        session = await client.open("a person walks")
        async for _ in session.frames(seconds=1):
            pass
        tokens.append(new)
        tenants.wall = EXPIRES_AT
        await until_true(lambda: session.stats.resumes)
        async for _ in session.frames(seconds=4):
            pass
        assert (session.stats.resumes, session.reopenings) == (1, ())


async def test_token_that_expires_without_a_next_one_ends_the_stream(tenants: TenantsFile) -> None:
    token = tenants.one(expires=EXPIRES)
    async with (
        asyncio.timeout(LIMIT_S),
        served(tenants) as server,
        MotionClient(server.address, token=token) as client,
    ):
        session = await client.open("a person walks")
        tenants.wall = EXPIRES_AT
        with pytest.raises(StreamLost) as lost:
            async for _ in session.frames(seconds=60):
                pass
        assert lost.value.reason == "CREDENTIALS_EXPIRED"


async def test_command_line_reaches_an_authenticating_server(
    tenants: TenantsFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    token = tenants.one()
    (tmp_path / "token").write_text(f"{token}\n")
    tls = ServerTls(TlsFiles(*copy_pair("server-1", tmp_path)))
    async with asyncio.timeout(LIMIT_S), served(tenants, tls) as server:
        words = ["catalog", "--server", server.address, "--tls-ca", AUTHORITY]
        assert await asyncio.to_thread(cli.run, words) == 1
        assert "CREDENTIALS_MISSING" in capsys.readouterr().err
        assert await asyncio.to_thread(cli.run, [*words, "--token-file", str(tmp_path / "token")]) == 0
        assert await asyncio.to_thread(cli.run, [*words, "--token-file", str(tmp_path / "nowhere")]) == 1
        assert "token-file" in capsys.readouterr().err
