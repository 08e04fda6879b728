"""CallPlaces: limits how many calls are open at once, of all callers together and of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial

from motiongen_server.rpc.errors.too_many_calls import too_many_calls_open

FIRST_ONES = 2
"""An address may have this many times its limit, for calls on connections that have none open: clients behind one proxy
share an address. A tenant's quota is not extended: a tenant knows its clients."""


class CallPlaces:
    """A place is held until gRPC is done with its call, even if the client does not take the answer.

    Lives on one event loop.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._taken: Counter[str] = Counter()
        self._of_connection: Counter[str] = Counter()

    def take(self, name: str, connection: str, most_of_one: int, kind: str = "address") -> Callable[[], None]:
        """Take a place for a call of the named caller; returns the function that gives it back.

        kind: of caller, "address" or "tenant". Raises StreamRefused if no place is free.
        """
        is_first = kind == "address" and not self._of_connection[connection]
        most = FIRST_ONES * most_of_one if is_first else most_of_one
        if self._taken[name] >= most:
            raise too_many_calls_open(most_of_one, kind)
        if self._taken.total() >= self._most:
            raise too_many_calls_open(self._most)
        self._taken[name] += 1
        self._of_connection[connection] += 1
        return partial(self._give_back, name, connection)

    def _give_back(self, name: str, connection: str) -> None:
        for counts, key in ((self._taken, name), (self._of_connection, connection)):
            counts[key] -= 1
            if not counts[key]:
                del counts[key]
