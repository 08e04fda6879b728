"""`motiongen-compliance`: with a server that keeps the protocol, with one that does not, and with wrong arguments."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import pytest

from motiongen_compliance.__main__ import main
from motiongen_server.identity.tls import ServerTls, TlsFiles
from tests.client.fake_server import FakeServer
from tests.conftest import ROOT
from tests.contract.local import LocalServer
from tests.server.identity.files import AUTHORITY, CERTIFICATES, TenantsFile, copy_pair

ROOMS = (ROOT / "compliance", ROOT / "proto" / "python")


def command(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run it in another folder, where it can import nothing of this repository but what it needs."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, ROOMS))}
    return subprocess.run(
        [sys.executable, "-m", "motiongen_compliance", *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


async def test_server_that_keeps_the_protocol_passes_in_real_time(tmp_path: Path) -> None:
    async with LocalServer() as server:
        words = "credit or windows_follow or continues_where or event_resent"
        done = await asyncio.to_thread(command, tmp_path, server.address, "-k", words)
    assert done.returncode == 0, done.stdout
    assert "4 passed" in done.stdout


def test_failing_server_gets_the_names_of_broken_rules(tmp_path: Path) -> None:
    with FakeServer() as server:
        done = command(tmp_path, server.address, "-k", "unknown_names")
    assert done.returncode == 1, done.stdout
    assert "test_unknown_names_are_refused_with_the_known_ones" in done.stdout


async def test_authenticating_server_is_tested_over_tls_with_a_token(tmp_path: Path) -> None:
    tenants = TenantsFile(tmp_path)
    (tmp_path / "token").write_text(tenants.one())
    tls = ServerTls(TlsFiles(*copy_pair("server-1", tmp_path), AUTHORITY))
    async with LocalServer(callers=tenants.callers(), tls=tls) as server:
        words = [server.address, "-k", "unknown_names or event_resent or takes_exactly_one", "--ca", AUTHORITY]
        words += ["--certificate", str(CERTIFICATES / "client.pem"), "--key", str(CERTIFICATES / "client.key")]
        refused = await asyncio.to_thread(command, tmp_path, *words)
        done = await asyncio.to_thread(command, tmp_path, *words, "--token-file", str(tmp_path / "token"))
    assert refused.returncode == 2, "the certificate is trusted, but belongs to no tenant"
    assert "not known to this server" in refused.stdout
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["localhost"], "give HOST:PORT"),
        ([":50051"], "give HOST:PORT"),
        (["localhost:65536"], "give HOST:PORT"),
        ([f"localhost:{'9' * 5000}"], "give HOST:PORT"),
        (["localhost:50051", "--ca", "no/such.pem"], "no file no/such.pem"),
        (["localhost:50051", "--token-file", "no/token"], "give --token-file one that can be read"),
        (["localhost:50051", "--key", AUTHORITY], "must be given together, and with --ca"),
    ],
)
def test_invalid_argument_is_reported(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("failure", "code", "said"),
    [
        (KeyboardInterrupt(), 2, "interrupted; nothing was tested"),
        (PermissionError(13, "Permission denied", "token"), 2, "Permission denied: 'token'"),
    ],
)
def test_failure_before_any_test_is_reported_in_one_line(
    failure: BaseException, code: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def fail(*_: object) -> None:
        raise failure

    monkeypatch.setattr("motiongen_compliance.__main__.reach", fail)
    try:
        ended: object = main(["localhost:50051"])
    except SystemExit as by_argparse:
        ended = by_argparse.code
    assert ended == code
    assert said in capsys.readouterr().err
