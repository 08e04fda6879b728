"""Streams and calls of callers with tokens: refusals, tenants' quotas, and credentials that expire or are revoked."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import grpc
import grpc.aio
import pytest

from motiongen.v1 import service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.heard import RuleBroken
from motiongen_compliance.talk import Talk
from motiongen_server.engine.types import Owner
from motiongen_server.identity.tokens import new_token
from motiongen_server.rpc.budgets.peers import Peers
from motiongen_server.rpc.limits import PeerLimits, ServiceLimits
from tests.contract.local import LocalServer
from tests.server.identity.files import TenantsFile, bearer
from tests.server.rpc.streams.test_stream_watch import end_of
from tests.waiting import LIMIT_S, until_true

HERO = session_pb2.PRIORITY_CLASS_HERO
EXPIRES, EXPIRES_AT = "2027-01-15T08:01:00Z", 1_800_000_060.0


@dataclass
class Line:
    """A channel to a server, for callers with tokens."""

    channel: grpc.aio.Channel
    address: str
    server: LocalServer

    @asynccontextmanager
    async def beside(self) -> AsyncIterator[Line]:
        """A channel from the same address, over a connection of its own."""
        options = [("grpc.use_local_subchannel_pool", 1)]
        async with grpc.aio.insecure_channel(self.address, options=options) as channel:
            yield Line(channel, self.address, self.server)

    async def catalog(self, token: str = "") -> service_pb2.GetCatalogResponse:
        stub = service_pb2_grpc.MotionServiceStub(self.channel)
        metadata = bearer(token) if token else ()
        return await stub.GetCatalog(service_pb2.GetCatalogRequest(), metadata=metadata)

    async def talk(self, token: str) -> Talk:
        stub, catalog = service_pb2_grpc.MotionServiceStub(self.channel), await self.catalog(token)
        begin = SimpleNamespace(StreamMotion=partial(stub.StreamMotion, metadata=bearer(token)))
        return await Talk(begin, catalog).hello()  # type: ignore[arg-type]


@asynccontextmanager
async def connected(tenants: TenantsFile, limits: ServiceLimits | None = None) -> AsyncIterator[Line]:
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(callers=tenants.callers(), service_limits=limits) as server,
        grpc.aio.insecure_channel(server.address) as channel,
    ):
        yield Line(channel, server.address, server)


async def test_calls_without_a_known_token_are_refused(tenants: TenantsFile) -> None:
    token = tenants.one()
    async with connected(tenants) as line:
        for wrong in ("", new_token()[0]):
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                await line.catalog(wrong)
            assert refused.value.code() is grpc.StatusCode.UNAUTHENTICATED
            stub = service_pb2_grpc.MotionServiceStub(line.channel)
            metadata = bearer(wrong) if wrong else ()
            assert await stub.StreamMotion(metadata=metadata).code() is grpc.StatusCode.UNAUTHENTICATED
            clip = stub.GenerateClip(service_pb2.GenerateClipRequest(), metadata=metadata)
            assert await clip.code() is grpc.StatusCode.UNAUTHENTICATED
        talk = await line.talk(token)
        await talk.open(1)
        await talk.plays_on(1)


async def test_guessed_tokens_are_charged_to_the_address_not_to_a_tenant(tenants: TenantsFile) -> None:
    token = tenants.one()
    async with connected(tenants, ServiceLimits(peer=PeerLimits(calls_per_second=0.1))) as line:
        codes = []
        for _ in range(3):
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                await line.catalog(new_token()[0])
            codes.append(refused.value.code().name)
        assert codes == ["UNAUTHENTICATED", "RESOURCE_EXHAUSTED", "RESOURCE_EXHAUSTED"]
        assert (await line.catalog(token)).models


async def test_tenants_quota_covers_all_its_streams(tenants: TenantsFile) -> None:
    token = tenants.one("quota = { heroes = 1, streams = 2 }")
    async with connected(tenants) as line:
        first, second = await line.talk(token), await line.talk(token)
        await first.open(1, priority=HERO)
        heard = await second.ask_open(1, priority=HERO)
        await second.until(lambda: heard.outcomes)
        assert (heard.outcomes[0].reason, "your tenant" in heard.outcomes[0].message) == ("PEER_SESSION_LIMIT", True)
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await line.talk(token)
        assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        assert "your tenant has as many streams as it may (quota streams), 2" in str(refused.value.details())


async def test_tenant_cannot_resume_another_tenants_session(tenants: TenantsFile) -> None:
    (one, its_hash), (other, other_hash) = new_token(), new_token()
    tenants.write(
        f"[tenants.a]\ntokens = [{{ hash = '{its_hash}' }}]\n[tenants.b]\ntokens = [{{ hash = '{other_hash}' }}]"
    )
    async with connected(tenants) as line:
        talk, thief = await line.talk(one), await line.talk(other)
        heard = await talk.open(1)
        talk.call.cancel()
        await thief.ask_resume(1, heard)
        await thief.until(lambda: heard.outcomes)
        assert heard.outcomes[0].reason == "SESSION_NOT_KEPT"
        heard.outcomes.clear()
        again = await line.talk(one)
        await again.resume(1, heard)


async def test_expiring_token_gets_a_goodbye_and_its_session_resumes_with_another(tenants: TenantsFile) -> None:
    (old, old_hash), (new, new_hash) = new_token(), new_token()
    tenants.write(f"[tenants.a]\ntokens = [{{ hash = '{old_hash}', expires = {EXPIRES} }}, {{ hash = '{new_hash}' }}]")
    async with connected(tenants) as line:
        talk = await line.talk(old)
        heard = await talk.open(1)
        tenants.wall = EXPIRES_AT - 5
        await talk.until(lambda: talk.responses[-1].HasField("goodbye"))
        goodbye = talk.responses[-1].goodbye
        assert goodbye.reason == service_pb2.GOODBYE_REASON_CREDENTIALS_EXPIRING
        assert goodbye.grace.ToMilliseconds() == 5000
        await talk.plays_on(1)
        tenants.wall = EXPIRES_AT
        assert await end_of(talk) == (grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_EXPIRED")
        again = await line.talk(new)
        await again.resume(1, heard)
        await again.plays_on(1)


async def test_removed_token_ends_its_stream_and_session(tenants: TenantsFile) -> None:
    token = tenants.one()
    async with connected(tenants) as line:
        talk = await line.talk(token)
        heard = await talk.open(1)
        another = tenants.one()
        assert await end_of(talk) == (grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_REVOKED")
        again = await line.talk(another)
        await again.ask_resume(1, heard)
        await again.until(lambda: heard.outcomes or heard.closed)
        assert (
            heard.closed or heard.outcomes[0].reason == "SESSION_NOT_KEPT"
        )  # closed: the notice that the session ended may still be on its way


async def test_sessions_beyond_their_tenants_steps_quota_are_refused(tenants: TenantsFile) -> None:
    token = tenants.one("quota = { steps_per_second = 5, share = 2 }")  # each session needs 2 a second
    async with connected(tenants) as line:
        talk = await line.talk(token)
        for handle in (1, 2):
            await talk.open(handle)
        with pytest.raises(RuleBroken, match="STEPS_QUOTA"):
            await talk.open(3)


async def test_changed_quota_applies_to_open_sessions(tenants: TenantsFile) -> None:
    token = tenants.one("quota = { share = 2, steps_per_second = 50 }")
    async with connected(tenants) as line:
        talk = await line.talk(token)
        await talk.open(1)
        tenants.write(tenants.path.read_text().replace("= 50 ", "= 5 "))

        def owner() -> Owner:
            (state,) = line.server.engine.sessions
            return state.spec.owner

        await until_true(lambda: owner().steps_per_s == 5)
        assert owner() == Owner("tenant:studio", 2, 5)
        await talk.plays_on(1)


async def test_reduced_quota_applies_to_a_stream_that_only_plays(tenants: TenantsFile) -> None:
    token = tenants.one("quota = { heroes = 2 }")
    async with connected(tenants) as line:
        talk = await line.talk(token)
        await talk.open(1, priority=HERO)
        (stream,) = line.server.service._streams.values()
        tenants.write(tenants.path.read_text().replace("heroes = 2", "heroes = 1"))
        await until_true(lambda: stream.peer.limits.heroes == 1)
        heard = await talk.ask_open(2, priority=HERO)
        await talk.until(lambda: heard.outcomes)
        assert heard.outcomes[0].reason == "PEER_SESSION_LIMIT"
        await talk.plays_on(1)


def test_changed_quota_applies_from_the_next_call(tenants: TenantsFile) -> None:
    token = tenants.one("quota = { events_per_second = 10 }")
    callers, peers = tenants.callers(), Peers()
    address = peers.find("ipv4:10.0.0.7:5", 0.0)
    peer = peers.of(callers.identify(bearer(token), {}), address, 0.0)
    peer.events.charge(20, 0.0)
    assert (peer is address, peer.kind, peer.events.owed_s(0.0)) == (False, "tenant", 1.0)
    assert address.events.owed_s(0.0) == 0
    tenants.write(tenants.path.read_text().replace("= 10 ", "= 40 "))
    assert peers.of(callers.identify(bearer(token), {}), address, 0.0) is peer
    assert (peer.limits.events_per_second, peer.events.owed_s(0.0)) == (40, 0.25)
