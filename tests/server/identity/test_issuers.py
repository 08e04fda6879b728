"""Streams and calls with tokens that an issuer signs, whose keys come from a real HTTP server, and may fail."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import NoReturn

import grpc
import grpc.aio
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_server.identity import callers
from motiongen_server.identity.jwt_tokens import unchecked
from motiongen_server.identity.tokens import new_token
from motiongen_server.rpc.budgets import check_budget
from motiongen_server.rpc.limits import PeerLimits, ServiceLimits
from tests.server.identity.files import TenantsFile, bearer
from tests.server.identity.issuer import Issuer
from tests.server.identity.test_streams import connected
from tests.server.rpc.streams.test_stream_watch import end_of


@pytest.fixture
def issuer(tenants: TenantsFile) -> Iterator[Issuer]:
    issuer = Issuer(first="ES256")
    tenants.wall = time.time()
    with issuer.served():
        tenants.write(issuer.entry(f"{issuer.url}/jwks"))
        yield issuer


async def test_stream_with_a_signed_token_gets_a_goodbye_before_it_expires(
    tenants: TenantsFile, issuer: Issuer
) -> None:
    expires_at = int(tenants.wall) + 1000
    async with connected(tenants) as line:
        talk = await line.talk(issuer.token(exp=expires_at))
        heard = await talk.open(1)
        await talk.plays_on(1)
        tenants.wall = expires_at + 30 - 5
        await talk.until(lambda: talk.responses[-1].HasField("goodbye"))
        assert talk.responses[-1].goodbye.reason == service_pb2.GOODBYE_REASON_CREDENTIALS_EXPIRING
        tenants.wall = expires_at + 30
        assert await end_of(talk) == (grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_EXPIRED")
        again = await line.talk(issuer.token(exp=expires_at + 1000))
        await again.resume(1, heard)
        await again.plays_on(1)
    assert issuer.asked == 1, "keys are fetched once for all calls"


async def test_newly_added_key_is_fetched_on_its_first_use(
    tenants: TenantsFile, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motiongen_server.identity.keys.RETRY_S", 0.0)
    async with connected(tenants) as line:
        assert (await line.catalog(issuer.token())).models
        issuer.keys["second"] = "RS256"
        assert (await line.catalog(issuer.token("second", "RS256"))).models
        assert issuer.asked == 2


async def test_issuer_outage_affects_only_tokens_with_unknown_keys(
    tenants: TenantsFile, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motiongen_server.identity.keys.RETRY_S", 0.0)
    async with connected(tenants) as line:
        assert (await line.catalog(issuer.token())).models
        issuer.is_down, issuer.keys["second"] = True, "ES256"
        assert (await line.catalog(issuer.token())).models
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await line.catalog(issuer.token("second"))
        assert refused.value.code() is grpc.StatusCode.UNAVAILABLE, "the token may prove valid once the issuer is back"
        issuer.is_down = False
        assert (await line.catalog(issuer.token("second"))).models


async def test_calls_before_the_first_key_fetch_get_unavailable(
    tenants: TenantsFile, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motiongen_server.identity.keys.RETRY_S", 0.0)
    issuer.is_down = True
    async with connected(tenants) as line:
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await line.catalog(issuer.token())
        assert (refused.value.code(), "cannot be fetched" in str(refused.value.details())) == (
            grpc.StatusCode.UNAVAILABLE,
            True,
        )
        status = rpc_status.from_call(refused.value)
        info, retry = error_details_pb2.ErrorInfo(), error_details_pb2.RetryInfo()
        assert (status.details[0].Unpack(info), status.details[1].Unpack(retry)) == (True, True)
        assert (info.reason, retry.retry_delay.ToSeconds()) == ("KEYS_UNAVAILABLE", 5)
        issuer.is_down = False
        assert (await line.catalog(issuer.token())).models


async def test_valid_new_tokens_are_admitted_despite_invalid_ones_from_their_address(
    tenants: TenantsFile, issuer: Issuer
) -> None:
    quota = "issuers = ['corp']\nquota = { calls_per_second = 100 }"
    tenants.write(issuer.entry(f"{issuer.url}/jwks", tenant=quota))
    async with connected(tenants, ServiceLimits(peer=PeerLimits(calls_per_second=1e-6))) as line:
        for number in range(5):
            for wrong in ("nonsense", new_token()[0], Issuer(first="RS256").token("first", "RS256")):
                with pytest.raises(grpc.aio.AioRpcError) as refused:
                    await line.catalog(wrong)
                assert refused.value.code() in (grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.RESOURCE_EXHAUSTED)
            assert (await line.catalog(issuer.token(number=number))).models


async def test_forged_tokens_beyond_their_connections_check_budget_are_not_parsed(
    tenants: TenantsFile, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check_budget, "CHECKS_PER_SECOND", 1e-6)
    read: list[str] = []
    monkeypatch.setattr(callers, "unchecked", lambda token: read.append(token) or unchecked(token))
    good, other = issuer.token(), issuer.token(number=2)
    async with connected(tenants) as line, line.beside() as another:
        assert (await line.catalog(good)).models
        read.clear()
        for number in range(3):
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                await line.catalog(Issuer(first="RS256").token("first", "RS256", number=number))
            asked = (refused.value.code(), "were invalid" in str(refused.value.details()))
            assert asked == (
                (grpc.StatusCode.RESOURCE_EXHAUSTED, True) if number else (grpc.StatusCode.UNAUTHENTICATED, False)
            )
        assert len(set(read)) == 1
        assert (await line.catalog(good)).models, "checked before, so it needs no budget"
        assert (await another.catalog(other)).models, "another connection has its own budget"


async def test_internal_error_shows_the_client_only_its_error_id(
    tenants: TenantsFile, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    token = tenants.one()

    def fail(*_: object) -> NoReturn:
        raise TypeError("unhashable type: 'list'")

    async with connected(tenants) as line:
        monkeypatch.setattr(callers.Callers, "identify", fail)
        with pytest.raises(grpc.aio.AioRpcError) as unary:
            await line.catalog(token)
        call = service_pb2_grpc.MotionServiceStub(line.channel).StreamMotion(metadata=bearer(token))
        for code, details in ((unary.value.code(), unary.value.details()), (await call.code(), await call.details())):
            assert code is grpc.StatusCode.INTERNAL
            assert "error id" in str(details)
            assert "unhashable" not in str(details)
            assert str(details).rpartition(" ")[2] in caplog.text


async def test_withdrawn_key_ends_the_streams_admitted_with_it(tenants: TenantsFile, issuer: Issuer) -> None:
    tenants.write(issuer.entry(f"{issuer.url}/jwks", "refresh_s = 1"))
    async with connected(tenants) as line:
        talk = await line.talk(issuer.token())
        await talk.open(1)
        issuer.keys = {"second": "ES256"}
        tenants.write(
            issuer.entry(f"{issuer.url}/jwks", "refresh_s = 2")
        )  # a changed entry: its keys are fetched again at once
        assert await end_of(talk) == (grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_REVOKED")
