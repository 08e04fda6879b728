"""Headers: limits a call's headers, which are checked before anything else of the call, and before gRPC reads them.

gRPC enforces the limit in the server's HTTP/2 settings only once the client has acknowledged them. A client that never
does may send 16 MiB, or a hundred thousand headers, which take the event loop half a second to read, and hundreds of
megabytes while the call lives. So a call with more headers than an acknowledging client could send is ended, and its
address must pay for the time that reading them took before the headers of its calls are read again. `grpc_server` asks
before it hands a call to gRPC, which would begin by reading all headers.
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


class HeaderTime:
    """Charges addresses for the time that reading too many headers takes. They have equal shares of LOOP_SHARE.

    One for each service. Lives on one event loop.
    """

    def __init__(self, clocks: Clocks = CLOCKS) -> None:
        self._clocks = clocks
        self._bucket = TokenBucket(LOOP_SHARE, clocks.elapsed_s())
        self._addresses: dict[str, Share] = {}

    @property
    def num_addresses(self) -> int:
        """Addresses that owe, or did lately."""
        return len(self._addresses)

    def check(self, context: Any) -> int:
        """The number of a call's headers. Raises StreamRefused if they are too many, or its address owes for others."""
        began_s = self._clocks.elapsed_s()
        address = address_of(context.peer())
        share = self._addresses.get(address)
        if share is not None and (owed_s := share.owed_s(began_s)) > 0:
            raise too_many_long_headers(owed_s)
        headers = context.invocation_metadata() or ()
        num_bytes = sum(BYTES_A_HEADER + len(name) + len(value) for name, value in headers)
        if num_bytes <= MOST_BYTES:
            return len(headers)
        del headers  # freeing them takes as long as reading, and must be charged too
        self._charge(address, began_s)
        raise headers_too_long(num_bytes, MOST_BYTES)

    def _charge(self, address: str, began_s: float) -> None:
        now = self._clocks.elapsed_s()
        self._addresses = {name: share for name, share in self._addresses.items() if share.owed_s(now) > 0}
        share = self._addresses.setdefault(address, Share(self._bucket, lambda: len(self._addresses), now))
        share.charge(now - began_s, now)
