"""Headers: how many a call may have, looked at before anything else of it, and before gRPC looks at it itself.

What gRPC's servers let through of a call's headers is what they told the client, once that has said that it knows: a
client that never says so may send 16 MiB, of a hundred thousand headers, which take the event loop half a second to
read and hundreds of megabytes as long as the call lives. So a call with more than any client that has said so can send
is ended, and what it took to read them is paid by its address before headers of that are read again, by anybody:
`grpc_server` asks before gRPC has a call served, which begins with reading them all.
"""

from __future__ import annotations

from typing import Any

from motiongen_server.rpc.budgets.loop_time import CLOCKS, Clocks
from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket
from motiongen_server.rpc.errors.calls import headers_too_long
from motiongen_server.rpc.errors.too_many_calls import too_many_long_headers

MOST_BYTES = 16 << 10
"""Counted as HTTP/2 does, and as gRPC lets through of a client that knows."""
BYTES_A_HEADER = 32
"""That one counts for besides its name and value (RFC 9113, 6.5.2)."""
LOOP_SHARE = 0.02
"""Of the event loop's time, seconds a second, to read headers of which there are too many."""


class HeaderTime:
    """Of the calls of a service: what reading too many headers has taken. Addresses have equal parts.

    Lives on one event loop.
    """

    def __init__(self, clocks: Clocks = CLOCKS) -> None:
        self._clocks = clocks
        self._bucket = TokenBucket(LOOP_SHARE, clocks.elapsed_s())
        self._addresses: dict[str, Share] = {}

    @property
    def num_addresses(self) -> int:
        """That owe, or have lately."""
        return len(self._addresses)

    def check(self, context: Any) -> int:
        """How many headers a call has. Raises StreamRefused where those are too many, or its address owes for such."""
        began_s = self._clocks.elapsed_s()
        address = address_of(context.peer())
        share = self._addresses.get(address)
        if share is not None and (owed_s := share.owed_s(began_s)) > 0:
            raise too_many_long_headers(owed_s)
        headers = context.invocation_metadata() or ()
        num_bytes = sum(BYTES_A_HEADER + len(name) + len(value) for name, value in headers)
        if num_bytes <= MOST_BYTES:
            return len(headers)
        del headers  # which takes as long again
        self._charge(address, began_s)
        raise headers_too_long(num_bytes, MOST_BYTES)

    def _charge(self, address: str, began_s: float) -> None:
        now = self._clocks.elapsed_s()
        self._addresses = {name: share for name, share in self._addresses.items() if share.owed_s(now) > 0}
        share = self._addresses.setdefault(address, Share(self._bucket, lambda: len(self._addresses), now))
        share.charge(now - began_s, now)
