"""Peers: finds the peer whose budgets a call uses: its tenant, or its address if it has none."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf
from typing import Any, cast
from urllib.parse import unquote

from motiongen_server.addresses import network_of
from motiongen_server.engine.types import Owner
from motiongen_server.identity.caller import Caller
from motiongen_server.rpc.budgets.loop_time import LoopTime
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.limits import PeerLimits

_IPV6 = "ipv6:"  # how gRPC's names of IPv6 peers begin
_TENANT = "tenant:"  # how names of tenants' peers begin; those of addresses never do
MOST_IDLE = 1024
"""Beyond this many peers, idle ones (`Peer.is_idle`) are forgotten, at most once in LOOK_EVERY_S."""
LOOK_EVERY_S = 1.0  # a search for each new address took a second where 2,000 came back at the same moment


class Peers:
    """All addresses and tenants that have something open, or owe something. Lives on the event loop."""

    def __init__(
        self,
        limits: PeerLimits | None = None,
        loop: LoopTime | None = None,
        note_owner: Callable[[Owner], None] = lambda owner: None,
    ) -> None:
        """loop: the time of the event loop; unlimited by default. note_owner: is given a tenant's `Owner` whenever it
        may have changed.
        """
        self._note_owner = note_owner
        self._limits = limits or PeerLimits()
        self._loop = loop or LoopTime()
        self._peers: dict[str, Peer] = {}
        self._looked_at = -inf

    def find(self, peer: str, now: float) -> Peer:
        """The peer of a call. peer: as gRPC names it."""
        return self._find(address_of(peer), "", self._limits, now)

    def of(self, caller: Caller, address: Peer, now: float) -> Peer:
        """The peer for which a caller's streams and calls count: its tenant, with its quota, or else its address."""
        if not caller.tenant:
            return address
        limits = self._limits_by(caller.quota)
        found = self._find(_TENANT + caller.tenant, caller.tenant, limits, now)
        self._adopt(found, limits, now)
        return found

    def renew(self, quotas: Mapping[str, Mapping[str, float]], now: float) -> None:
        """Apply new quotas, also to tenants that send nothing at present. quotas: by tenant."""
        for tenant, quota in quotas.items():
            if (found := self._peers.get(_TENANT + tenant)) is not None:
                self._adopt(found, self._limits_by(quota), now)

    def _adopt(self, tenant: Peer, limits: PeerLimits, now: float) -> None:
        before = tenant.owner
        tenant.adopt(limits, now)
        if tenant.owner != before:
            self._note_owner(tenant.owner)

    def _limits_by(self, quota: Mapping[str, float]) -> PeerLimits:
        return replace(self._limits, **cast(dict[str, Any], quota))

    def _find(self, name: str, tenant: str, limits: PeerLimits, now: float) -> Peer:
        found = self._peers.get(name)
        if found is None:
            if len(self._peers) >= MOST_IDLE and now - self._looked_at >= LOOK_EVERY_S:
                self._looked_at = now
                self._peers = {name: held for name, held in self._peers.items() if not held.is_idle(now)}
            found = self._peers[name] = Peer(limits, now, tenant, name, self._loop)
            if tenant:  # engines may remember an older quota from before the peer was forgotten here
                self._note_owner(found.owner)
        return found


def address_of(peer: str) -> str:
    """The address by which a call is counted: without its port, ipv4:10.0.0.7:55000 -> ipv4:10.0.0.7; for IPv6 the
    network (`network_of`), ipv6:%5B2001:db8::7%5D:55000 -> ipv6:2001:db8::/64; all unix sockets count as one.
    """
    if peer.startswith("unix"):
        return "unix"
    name = peer.rpartition(":")[0] or peer
    if not name.startswith(_IPV6):
        return name
    host = unquote(name.removeprefix(_IPV6)).removeprefix("[").removesuffix("]")
    network = network_of(host)
    return f"{_IPV6 if ':' in network else 'ipv4:'}{network}"
