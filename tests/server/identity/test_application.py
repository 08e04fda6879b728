"""The application with TLS and tenants: each of its ports (gateway, administration, metrics) applies its own rules."""

from __future__ import annotations

import ssl
from pathlib import Path

import grpc
import grpc.aio
import httpx
import pytest

from motiongen.v1 import admin_pb2, admin_pb2_grpc, service_pb2, service_pb2_grpc
from motiongen_server.settings import SettingError
from tests.server.application import application_of, config, running
from tests.server.identity.files import AUTHORITY, TenantsFile, bearer, client_credentials, copy_pair


async def test_each_port_applies_its_own_rules_with_tls_and_tenants(tenants: TenantsFile, tmp_path: Path) -> None:
    certificate, key = copy_pair("server-1", tmp_path)
    token = tenants.one("roles = ['motion', 'metrics']")
    settings = config(
        host="0.0.0.0",
        ops_host="0.0.0.0",
        admin_listen="127.0.0.1:0",
        tls_certificate=certificate,
        tls_key=key,
        tenants=str(tenants.path),
    )
    async with running(settings) as application:
        address = f"localhost:{application.grpc_port}"
        async with grpc.aio.secure_channel(address, client_credentials()) as channel:
            stub = service_pb2_grpc.MotionServiceStub(channel)
            catalog = await stub.GetCatalog(service_pb2.GetCatalogRequest(), metadata=bearer(token))
            assert catalog.models
        async with grpc.aio.insecure_channel(f"127.0.0.1:{application.admin_port}") as channel:
            admin = admin_pb2_grpc.MotionAdminServiceStub(channel)
            for metadata, code in (((), "UNAUTHENTICATED"), (bearer(token), "PERMISSION_DENIED")):
                assert (await admin.ListModels(admin_pb2.ListModelsRequest(), metadata=metadata).code()).name == code
        async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{application.ops_port}") as client:
            assert (await client.get("/readyz")).status_code == 200
            refused = await client.get("/metrics")
            assert (refused.status_code, refused.headers["WWW-Authenticate"]) == (401, "Bearer")
            shown = await client.get("/metrics", headers={"Authorization": f"Bearer {token}"})
            assert "motiongen_streams" in shown.text


async def test_ops_port_serves_tls_with_the_renewed_certificate(tenants: TenantsFile, tmp_path: Path) -> None:
    certificate, key = copy_pair("server-1", tmp_path)
    token = tenants.one("roles = ['metrics']")
    settings = config(
        ops_host="0.0.0.0", ops_tls=True, tls_certificate=certificate, tls_key=key, tenants=str(tenants.path)
    )
    trust = ssl.create_default_context(cafile=AUTHORITY)
    async with running(settings) as application:
        url = f"https://localhost:{application.ops_port}/metrics"

        async def shown() -> tuple[int, str]:
            """The HTTP status, and the common name in the server's certificate."""
            async with (
                httpx.AsyncClient(verify=trust) as client,
                client.stream("GET", url, headers={"Authorization": f"Bearer {token}"}) as answer,
            ):
                handshake = answer.extensions["network_stream"].get_extra_info("ssl_object")
                return answer.status_code, str(
                    dict(part[0] for part in handshake.getpeercert()["subject"])["commonName"]
                )

        assert await shown() == (200, "server-1")
        copy_pair("server-2", tmp_path)
        assert await shown() == (200, "server-2")
        async with httpx.AsyncClient() as client:
            with pytest.raises(httpx.TransportError):
                await client.get(url.replace("https", "http"))
            with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
                await client.get(url)


async def test_metrics_tokens_over_plain_http_are_warned_about(
    tenants: TenantsFile, caplog: pytest.LogCaptureFixture
) -> None:
    tenants.one()
    async with running(config(ops_host="0.0.0.0", tenants=str(tenants.path))):
        pass
    assert any("--ops-tls encrypts them" in message for message in caplog.messages)


async def test_grpc_served_to_other_machines_without_tls_is_warned_about(caplog: pytest.LogCaptureFixture) -> None:
    async with running(config(host="0.0.0.0", insecure=True)):
        pass
    (warning,) = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert "gRPC is served to other machines on 0.0.0.0 without TLS" in warning


async def test_server_listens_on_a_unix_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # a relative path: the system limits the length of a socket's name
    async with running(config(host="unix:motion.sock")) as application:
        assert application.grpc_port == 0
        async with grpc.aio.insecure_channel("unix:motion.sock") as channel:
            stub = service_pb2_grpc.MotionServiceStub(channel)
            assert (await stub.GetCatalog(service_pb2.GetCatalogRequest())).models  # type: ignore[misc]


@pytest.mark.parametrize(("setting", "said"), [("tenants", "tenants cannot be read"), ("tls", "TLS cannot be served")])
async def test_missing_tenant_or_tls_files_fail_the_start(setting: str, said: str, tmp_path: Path) -> None:
    nowhere = str(tmp_path / "nowhere")
    given = {"tenants": nowhere} if setting == "tenants" else {"tls_certificate": nowhere, "tls_key": nowhere}
    with pytest.raises(SettingError, match=said):
        await application_of(config(**given)).start()
