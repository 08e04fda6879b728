"""CallAdmission: who calls, found out and charged before anything that is sent is looked at."""

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
    """Of the calls of a service. Lives on one event loop."""

    def __init__(
        self,
        callers: Callers,
        peers: Peers,
        most_calls: int,
        role: Role = Role.MOTION,
        memory: WaitingMemory | None = None,
    ) -> None:
        """peers: whom calls are charged to. most_calls: that have one request. role: that callers must have.

        memory: in which counts what is held of requests, besides among what their peers hold; None: there is none.
        """
        self._callers = callers
        self._quotas = NO_QUOTAS
        self._peers = peers
        self._places = CallPlaces(most_calls)
        self._role = role
        self._checks = CheckBudget()
        self._memory = memory

    def renew_quotas(self) -> None:
        """Have tenants go by what their file says, as of the last look at it. Asked a few times a second."""
        if (quotas := self._callers.quotas) is not self._quotas:
            self._quotas = quotas
            self._peers.renew(quotas, time.monotonic())

    async def charge(self, context: Context | CallContext) -> tuple[Peer, Caller]:
        """Find out who calls, and charge the call to its tenant, or its address where it has none or may not call.

        Raises StreamRefused for who may not call, and while that owes: there is nothing to be read later.
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
        """Who calls. A token that has to be read and checked is paid for by its connection unless it holds."""
        metadata, give_back = context.invocation_metadata() or (), None
        if num_characters := self._callers.num_unchecked(metadata):
            give_back = self._checks.charge(context.peer(), num_characters)
        await keys_for(self._callers, metadata)
        caller = self._callers.identify(metadata, context.auth_context(), self._role)
        if give_back is not None:
            give_back()
        return caller

    async def request(self, call: CallContext, most_bytes: int | None = SMALL_REQUEST_BYTES) -> tuple[Peer, bytes]:
        """The request of a call, which has a place from before it comes, and who sent it. Raises StreamRefused.

        most_bytes: that it may have; None: as many as the port lets through.
        """
        peer, _ = await self.charge(call)
        call.hold(self._places.take(peer.name, call.peer(), peer.limits.calls, peer.kind))
        return peer, await call.request(most_bytes, partial(self._arrive, peer))

    @contextmanager
    def _arrive(self, peer: Peer, request: AwaitedRequest) -> Iterator[None]:
        """A request has come, and is held for the time of the block, in which its client may keep its side open.

        Raises StreamRefused where there is more held than may be, and it is one that has to go.
        """
        num_bytes, now = request.num_waiting_bytes, time.monotonic()
        peer.calls.charge(num_bytes / BYTES_A_CALL, now)
        peer.bytes.charge(num_bytes, now)
        request.owed_s = peer.calls.owed_s
        try:
            with peer.holding(request, num_bytes), self._counted(request):
                yield
        except Ended:
            if request.refusal is None:  # it was ended by none but those that hold it
                raise
            raise request.refusal from None

    def _counted(self, request: AwaitedRequest) -> AbstractContextManager[None]:
        return nullcontext() if self._memory is None else self._memory.holding(request)
