"""TLS: which clients can connect, and certificates that are renewed while streams play."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path

import grpc
import grpc.aio
import pytest

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_compliance.talk import Talk
from motiongen_server.identity.tls import Renewal, ServerTls, TlsFiles
from motiongen_server.identity.watched import Watched
from motiongen_server.settings import SettingError
from tests.channels import ALONE
from tests.contract.local import LocalServer
from tests.server.identity.files import AUTHORITY, CERTIFICATES, client_credentials, copy_pair
from tests.waiting import LIMIT_S

RELOADS = 100


def served(folder: Path, client_ca: str = "") -> LocalServer:
    return LocalServer(tls=ServerTls(TlsFiles(*copy_pair("server-1", folder), client_ca)))


async def code_of(address: str, credentials: grpc.ChannelCredentials | None) -> grpc.StatusCode:
    """The status of a call for the catalogue."""
    if credentials is None:
        channel = grpc.aio.insecure_channel(address, options=ALONE)
    else:
        channel = grpc.aio.secure_channel(address, credentials, options=ALONE)
    async with channel:
        call = service_pb2_grpc.MotionServiceStub(channel).GetCatalog(service_pb2.GetCatalogRequest(), timeout=LIMIT_S)
        return await call.code()


async def shown_name(address: str) -> str:
    """The common name of the certificate that a server shows to a new connection."""
    host, _, port = address.rpartition(":")
    context = ssl.create_default_context(cafile=AUTHORITY)
    context.set_alpn_protocols(["h2"])
    _, writer = await asyncio.open_connection(host, int(port), ssl=context)
    subject = writer.get_extra_info("peercert")["subject"]
    writer.transport.abort()  # not closed cleanly: that would wait for the peer's HTTP/2 settings
    return str(dict(pair for part in subject for pair in part)["commonName"])


async def test_clients_must_speak_tls_and_trust_the_servers_authority(tmp_path: Path) -> None:
    async with asyncio.timeout(LIMIT_S), served(tmp_path) as server:
        stranger = (CERTIFICATES / "stranger-authority.pem").read_bytes()
        assert await code_of(server.address, client_credentials()) is grpc.StatusCode.OK
        assert await code_of(server.address, None) is grpc.StatusCode.UNAVAILABLE
        assert await code_of(server.address, grpc.ssl_channel_credentials(stranger)) is grpc.StatusCode.UNAVAILABLE


async def test_with_a_client_authority_clients_must_present_its_certificate(tmp_path: Path) -> None:
    async with asyncio.timeout(LIMIT_S), served(tmp_path, AUTHORITY) as server:
        assert await code_of(server.address, client_credentials("client")) is grpc.StatusCode.OK
        assert await code_of(server.address, client_credentials()) is grpc.StatusCode.UNAVAILABLE
        assert await code_of(server.address, client_credentials("stranger")) is grpc.StatusCode.UNAVAILABLE


async def test_hundred_certificate_renewals_under_load_end_no_stream(tmp_path: Path) -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        served(tmp_path, AUTHORITY) as server,
        grpc.aio.secure_channel(server.address, client_credentials("client"), options=ALONE) as channel,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        catalog = await stub.GetCatalog(service_pb2.GetCatalogRequest())  # type: ignore[misc]
        talks = [await Talk(stub, catalog).hello() for _ in range(4)]  # type: ignore[arg-type]
        for talk in talks:
            await talk.open(1)
        for number in range(RELOADS):
            copy_pair(f"server-{1 + (number + 1) % 2}", tmp_path)
            assert await code_of(server.address, client_credentials("client")) is grpc.StatusCode.OK
            await talks[number % len(talks)].ping(number)
        for talk in talks:
            await talk.call.done_writing()
            assert await talk.to_the_end() is grpc.StatusCode.OK


async def test_new_connections_are_shown_the_renewed_certificate(tmp_path: Path) -> None:
    async with asyncio.timeout(LIMIT_S), served(tmp_path) as server:
        assert await shown_name(server.address) == "server-1"
        copy_pair("server-2", tmp_path)
        assert await shown_name(server.address) == "server-2"


async def test_mismatched_certificate_and_key_keep_the_old_pair(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with asyncio.timeout(LIMIT_S), served(tmp_path) as server:
        (tmp_path / "server.pem").write_bytes((CERTIFICATES / "server-2.pem").read_bytes())
        for _ in range(2):
            assert await shown_name(server.address) == "server-1"
        assert len([line for line in caplog.messages if "not a certificate and its key" in line]) == 1
        (tmp_path / "server.key").write_bytes((CERTIFICATES / "server-2.key").read_bytes())
        assert await shown_name(server.address) == "server-2"


def test_grpc_is_given_certificates_only_when_they_changed(tmp_path: Path) -> None:
    files = TlsFiles(*copy_pair("server-1", tmp_path))
    renewal = Renewal(Watched("certificates", files.paths, files.read))
    assert [renewal(), renewal()] == [None, None]
    copy_pair("server-2", tmp_path)
    assert renewal() is renewal.given
    assert renewal() is None


@pytest.mark.parametrize(
    ("files", "said"),
    [
        (("server-1.pem", "server-2.key", ""), "not a certificate and its key"),
        (("make.sh", "server-1.key", ""), "not a certificate and its key"),
        (("nowhere.pem", "server-1.key", ""), "No such file"),
        (("server-1.pem", "server-1.key", "make.sh"), "no certificates of authorities"),
        (("server-1.pem", "server-1.key", "client.pem"), "none of a certificate authority"),
        (("server-1.pem", "server-1.key", "nowhere.pem"), "No such file"),
    ],
)
def test_unusable_tls_files_fail_the_start_with_a_reason(files: tuple[str, str, str], said: str) -> None:
    with pytest.raises(SettingError, match=said):
        ServerTls(TlsFiles(*(name and str(CERTIFICATES / name) for name in files)))
