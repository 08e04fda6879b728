"""The C++ client and the real service over TLS, with tokens that are valid, invalid or expire."""

from __future__ import annotations

import asyncio
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motiongen_server.identity.tls import ServerTls, TlsFiles
from motiongen_server.identity.tokens import new_token
from tests.contract.local import LocalServer
from tests.cpp.test_client import Character, character
from tests.cpp.test_load import play as play_load
from tests.e2e.lost_line import FACTS_AS_SERVED
from tests.server.identity.files import AUTHORITY, CERTIFICATES, TenantsFile, copy_pair
from tests.waiting import LIMIT_S

EXPIRES, EXPIRES_AT = "2027-01-15T08:01:00Z", 1_800_000_060.0
Program = Callable[[str], Path]


def served(tenants: TenantsFile, tls: ServerTls | None = None, listen: str = "127.0.0.1:0") -> LocalServer:
    return LocalServer(facts=FACTS_AS_SERVED, callers=tenants.callers(), tls=tls, listen=listen)


def play(walker: Character) -> None:
    walker.tell("wait 50")
    assert walker.hear("frame")[2] == "OK"


@pytest.mark.parametrize("is_socket", [False, True], ids=["by TCP", "a socket of this machine"])
async def test_client_certificate_and_token_admit_a_client_over_tls(
    program: Program, tmp_path: Path, is_socket: bool
) -> None:
    tenants = TenantsFile(tmp_path)
    shown = {
        "MOTIONGEN_CERTIFICATE": str(CERTIFICATES / "client.pem"),
        "MOTIONGEN_KEY": str(CERTIFICATES / "client.key"),
    }
    shown |= {"MOTIONGEN_CA": AUTHORITY, "MOTIONGEN_TOKEN": tenants.one()}

    def stream(address: str) -> None:
        with character(program, address, **shown) as walker:
            play(walker)

    tls = ServerTls(TlsFiles(*copy_pair("server-1", tmp_path), AUTHORITY))
    listen = f"unix:{tmp_path / 's'}" if is_socket else "127.0.0.1:0"
    async with asyncio.timeout(LIMIT_S), served(tenants, tls, listen) as server:
        await asyncio.to_thread(stream, server.address)
        nobody = {**shown, "MOTIONGEN_CERTIFICATE": "", "MOTIONGEN_KEY": ""}
        assert "no motiongen server answers" in await refusal(program, server, nobody)


async def test_load_program_runs_over_tls_with_a_token(program: Program, tmp_path: Path) -> None:
    tenants = TenantsFile(tmp_path)
    token_file = tmp_path / "token"
    token_file.write_text(tenants.one(), encoding="utf-8")
    shown = ["--tls-ca", str(CERTIFICATES / "authority.pem"), "--token-file", str(token_file)]
    shown += ["--tls-certificate", str(CERTIFICATES / "client.pem"), "--tls-key", str(CERTIFICATES / "client.key")]

    def load(address: str) -> dict[str, Any]:
        return play_load(address, tmp_path, "tls", *shown, "--program", str(program("motiongen-load")))

    tls = ServerTls(TlsFiles(*copy_pair("server-1", tmp_path), AUTHORITY))
    async with asyncio.timeout(LIMIT_S), served(tenants, tls) as server:
        told = await asyncio.to_thread(load, server.address)
    assert told["generator"]["program"].startswith("motiongen-load ")
    assert told["latencies_ms"]["open_to_first_frame"]["all"]["count"] > 0
    assert not [name for name in told["counts"] if name.startswith("stream")]


async def test_refused_client_reports_the_reason(program: Program, tmp_path: Path) -> None:
    tenants = TenantsFile(tmp_path)
    token = tenants.one("roles = ['metrics']")
    async with asyncio.timeout(LIMIT_S), served(tenants) as server:
        for given, reason in (
            ("", "CREDENTIALS_MISSING"),
            (new_token()[0], "CREDENTIALS_INVALID"),
            (token, "ROLE_MISSING"),
        ):
            assert (await refusal(program, server, {"MOTIONGEN_TOKEN": given})).startswith(reason + " ")


async def refusal(program: Program, server: LocalServer, variables: dict[str, str]) -> str:
    """The reason that the client gives for not connecting."""

    def connect() -> str:
        command, environment = [program("told_events"), server.address], {**os.environ, **variables}
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment)
        assert done.returncode == 1
        return done.stderr.splitlines()[-1]

    return await asyncio.to_thread(connect)


def replace_at_once(file: Path, text: str) -> None:
    """Replace a file in one step, so that a reader finds either the old or the whole new text."""
    beside = file.with_suffix(".next")
    beside.write_text(text, encoding="utf-8")
    beside.replace(file)


@pytest.mark.parametrize("is_late", [False, True], ids=["at hand", "late"])
async def test_session_continues_with_a_new_token_after_the_old_one_expires(
    program: Program, tmp_path: Path, is_late: bool
) -> None:
    """is_late: at first there is no new token, and the token function throws."""
    tenants, file = TenantsFile(tmp_path), tmp_path / "token"
    (old, old_hash), (new, new_hash) = new_token(), new_token()
    tenants.write(f"[tenants.a]\ntokens = [{{ hash = '{old_hash}', expires = {EXPIRES} }}, {{ hash = '{new_hash}' }}]")
    replace_at_once(file, old)

    def stream(address: str) -> None:
        with character(program, address, MOTIONGEN_TOKEN_FILE=str(file)) as walker:
            play(walker)
            tenants.wall = EXPIRES_AT - 5
            walker.hear("draining")
            replace_at_once(file, "" if is_late else new)
            tenants.wall = EXPIRES_AT
            assert walker.hear("lost")[1] == "UNAUTHENTICATED"
            if is_late:
                for _ in range(3):
                    walker.hear("no_token")
                replace_at_once(file, new)
            _, first, exact = walker.hear("recovered")
            assert exact == "1"
            walker.tell(f"wait {int(first) + 40}")
            assert walker.hear("frame")[2] == "OK"

    async with asyncio.timeout(LIMIT_S), served(tenants) as server:
        await asyncio.to_thread(stream, server.address)


async def test_expired_token_without_a_new_one_ends_the_session(program: Program, tmp_path: Path) -> None:
    tenants = TenantsFile(tmp_path)
    token = tenants.one(expires=EXPIRES)

    def stream(address: str) -> None:
        with character(program, address, MOTIONGEN_TOKEN=token) as walker:
            play(walker)
            tenants.wall = EXPIRES_AT
            assert walker.hear("closed")[1] == "CREDENTIALS_EXPIRED"

    async with asyncio.timeout(LIMIT_S), served(tenants) as server:
        await asyncio.to_thread(stream, server.address)
