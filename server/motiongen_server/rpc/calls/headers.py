"""Headers: limits a call's headers, which are checked before anything else of the call, and before gRPC reads them.

gRPC enforces the limit in the server's HTTP/2 settings only once the client has acknowledged them. A client that never
does may send 16 MiB, or a hundred thousand headers, which take the event loop half a second to read, and hundreds of
megabytes while the call lives. So a call with more headers than an acknowledging client could send is ended, and its
address must pay for the time that reading them took before the headers of its calls are read again. `grpc_server` asks
before it hands a call to gRPC, which would begin by reading all headers.

Clients behind one address translation share an address. So calls over connections that have begun ordinary calls before
are read all the same, until some of these connections send too many headers, too.
"""

from __future__ import annotations

from typing import Any

from motiongen_server.rpc.budgets.loop_time import CLOCKS, Clocks
from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket
from motiongen_server.rpc.errors.calls import headers_too_long
from motiongen_server.rpc.errors.too_many_calls import too_many_long_headers

MOST_BYTES = 16 << 10
"""Counted as in HTTP/2: what gRPC lets through from a client that has acknowledged the settings."""
BYTES_A_HEADER = 32
"""Overhead of each header, in addition to its name and value (RFC 9113, 6.5.2)."""
LOOP_SHARE = 0.02
"""Event loop time for reading headers of calls that have too many, seconds per second."""
MOST_KNOWN = 8192
"""Connections that are remembered for their ordinary calls."""
MOST_OFFENCES = 4
"""Calls with too many headers that known connections of an address may send while it owes; then none is read."""


class _Debtor:
    """An address that owes. num_offences: of known connections, since it began to owe."""

    def __init__(self, share: Share) -> None:
        self.share = share
        self.num_offences = 0


class HeaderTime:
    """Charges addresses for the time that reading too many headers takes. They have equal shares of LOOP_SHARE.

    One for each service. Lives on one event loop.
    """

    def __init__(self, clocks: Clocks = CLOCKS) -> None:
        self._clocks = clocks
        self._bucket = TokenBucket(LOOP_SHARE, clocks.elapsed_s())
        self._addresses: dict[str, _Debtor] = {}
        self._known: dict[str, None] = {}  # connections, the one that has been silent for longest first

    @property
    def num_addresses(self) -> int:
        """Addresses that owe, or did lately."""
        return len(self._addresses)

    def check(self, context: Any) -> int:
        """The number of a call's headers. Raises StreamRefused if they are too many, or its address owes for others."""
        began_s = self._clocks.elapsed_s()
        peer = context.peer()
        debtor = self._addresses.get(address_of(peer))
        is_trusted = debtor is None or (peer in self._known and debtor.num_offences < MOST_OFFENCES)
        if debtor is not None and not is_trusted and (owed_s := debtor.share.owed_s(began_s)) > 0:
            raise too_many_long_headers(owed_s)
        num_headers, num_bytes = _read(context)
        if num_bytes <= MOST_BYTES:
            self._remember(peer)
            return num_headers
        self._charge(peer, began_s)
        raise headers_too_long(num_bytes, MOST_BYTES)

    def _remember(self, peer: str) -> None:
        self._known.pop(peer, None)
        self._known[peer] = None
        if len(self._known) > MOST_KNOWN:
            del self._known[next(iter(self._known))]

    def _charge(self, peer: str, began_s: float) -> None:
        now = self._clocks.elapsed_s()
        self._addresses = {name: each for name, each in self._addresses.items() if each.share.owed_s(now) > 0}
        debtor = self._addresses.get(address := address_of(peer))
        if debtor is None:
            debtor = self._addresses[address] = _Debtor(Share(self._bucket, lambda: len(self._addresses), now))
        elif peer in self._known:
            debtor.num_offences += 1
        self._known.pop(peer, None)
        debtor.share.charge(now - began_s, now)


def _read(context: Any) -> tuple[int, int]:
    """How many headers a call has, and their size. They are freed on return, which takes as long as counting them."""
    headers = context.invocation_metadata() or ()
    return len(headers), sum(BYTES_A_HEADER + len(name) + len(value) for name, value in headers)
