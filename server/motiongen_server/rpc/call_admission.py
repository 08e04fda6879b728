"""CallAdmission: who calls, found out and charged before anything that is sent is looked at."""

from __future__ import annotations

import time
from typing import Any, TypeAlias

import grpc.aio

from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import Caller, Role
from motiongen_server.identity.callers import Callers
from motiongen_server.rpc.budget import BYTES_A_CALL, CALL_COST
from motiongen_server.rpc.call_context import CallContext
from motiongen_server.rpc.call_places import CallPlaces
from motiongen_server.rpc.check_budget import CheckBudget
from motiongen_server.rpc.issuer_keys import keys_for
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.loop_time import LoopTime
from motiongen_server.rpc.peers import Peer, Peers
from motiongen_server.rpc.stream_errors import failed_inside

Context: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"


class CallAdmission:
    """Of the calls of a service. Lives on one event loop."""

    def __init__(
        self,
        callers: Callers,
        limits: PeerLimits | None,
        most_calls: int,
        role: Role = Role.MOTION,
        loop: LoopTime | None = None,
    ) -> None:
        """limits: of one address, and of a tenant whose quota says nothing else. most_calls: that have one request.

        role: that callers must have. loop: the event loop's time, of which peers have parts; None: without a limit.
        """
        self._callers = callers
        self._peers = Peers(limits, loop)
        self._places = CallPlaces(most_calls)
        self._role = role
        self._checks = CheckBudget()

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

    async def request(self, call: CallContext) -> tuple[Peer, bytes]:
        """The request of a call, which has a place from before it comes, and who sent it. Raises StreamRefused."""
        peer, _ = await self.charge(call)
        call.hold(self._places.take(peer.name, call.peer(), peer.limits.calls, peer.kind))
        request = await call.request()
        peer.calls.charge(len(request) / BYTES_A_CALL, time.monotonic())
        return peer, request
