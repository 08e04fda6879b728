"""CallAdmission: identifies the caller and charges the call before looking at anything that is sent."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from typing import Any, TypeAlias

import grpc.aio

from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import Caller, Role
from motiongen_server.identity.callers import NO_QUOTAS, Callers
from motiongen_server.rpc.budgets.call_places import CallPlaces
from motiongen_server.rpc.budgets.check_budget import CheckBudget
from motiongen_server.rpc.budgets.held_requests import Ended
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.peers import Peers
from motiongen_server.rpc.budgets.stream_budget import BYTES_A_CALL, CALL_COST
from motiongen_server.rpc.budgets.waiting_memory import WaitingMemory
from motiongen_server.rpc.calls.context import CallContext
from motiongen_server.rpc.calls.issuer_keys import keys_for
from motiongen_server.rpc.calls.requests import SMALL_REQUEST_BYTES, AwaitedRequest
from motiongen_server.rpc.errors.streams import failed_inside

Context: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"


class CallAdmission:
    """Admits the calls of a service. Lives on one event loop."""

    def __init__(
        self,
        callers: Callers,
        peers: Peers,
        most_calls: int,
        role: Role = Role.MOTION,
        memory: WaitingMemory | None = None,
    ) -> None:
        """peers: whom calls are charged to. most_calls: open calls that take one request. role: required of callers.

        memory: accounts for held requests of all peers together; None: only each peer's own account counts them.
        """
        self._callers = callers
        self._quotas = NO_QUOTAS
        self._peers = peers
        self._places = CallPlaces(most_calls)
        self._role = role
        self._checks = CheckBudget()
        self._memory = memory

    def renew_quotas(self) -> None:
        """Apply the tenants' file as last read to the tenants' quotas. Called a few times a second."""
        if (quotas := self._callers.quotas) is not self._quotas:
            self._quotas = quotas
            self._peers.renew(quotas, time.monotonic())

    async def charge(self, context: Context | CallContext) -> tuple[Peer, Caller]:
        """Identify the caller, and charge the call to its tenant, or to its address if it has none or may not call.

        Raises StreamRefused if the caller may not call, or owes for calls: a call cannot be delayed like a stream.
        """
        address = self._peers.find(context.peer(), time.monotonic())
        try:
            caller = await self._identify(context)
        except StreamRefused:
            address.charge_call(CALL_COST, time.monotonic())
            raise
        except Exception as error:
            address.charge_call(CALL_COST, time.monotonic())  # so a fault is logged no more often than calls may be
            raise failed_inside("a call was not let in", "the call failed inside the server", error) from error
        now = time.monotonic()
        peer = self._peers.of(caller, address, now)
        peer.charge_call(CALL_COST, now)
        return peer, caller

    async def _identify(self, context: Context | CallContext) -> Caller:
        """Identify the caller. The connection pays for the check of an unknown token unless the token is valid."""
        metadata, give_back = context.invocation_metadata() or (), None
        if num_characters := self._callers.num_unchecked(metadata):
            give_back = self._checks.charge(context.peer(), num_characters)
        await keys_for(self._callers, metadata)
        caller = self._callers.identify(metadata, context.auth_context(), self._role)
        if give_back is not None:
            give_back()
        return caller

    async def request(self, call: CallContext, most_bytes: int | None = SMALL_REQUEST_BYTES) -> tuple[Peer, bytes]:
        """Take a place for a call, await its request, and return the caller's peer and the request.

        most_bytes: allowed for the request; None: as many as the port lets through. Raises StreamRefused.
        """
        peer, _ = await self.charge(call)
        call.hold(self._places.take(peer.name, call.peer(), peer.limits.calls, peer.kind))
        call.hold(peer.begin_call())  # else it might be forgotten before the request comes, and its quotas be had anew
        return peer, await call.request(most_bytes, partial(self._arrive, peer))

    @contextmanager
    def _arrive(self, peer: Peer, request: AwaitedRequest) -> Iterator[None]:
        """Charge a request that has come, and count it as held for the block, until its client closes its side.

        Raises StreamRefused if it is ended because too much is held.
        """
        num_bytes, now = request.num_waiting_bytes, time.monotonic()
        peer.calls.charge(num_bytes / BYTES_A_CALL, now)
        peer.bytes.charge(num_bytes, now)
        request.owed_s, request.peer_name = peer.calls.owed_s, peer.name
        try:
            with peer.holding(request, num_bytes), self._counted(request):
                yield
        except Ended:
            if request.refusal is None:  # cannot be: Ended is raised only once it is set
                raise
            raise request.refusal from None

    def _counted(self, request: AwaitedRequest) -> AbstractContextManager[None]:
        return nullcontext() if self._memory is None else self._memory.holding(request)
