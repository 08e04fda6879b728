"""WaitingMemory: one account of all that the process holds until clients read, confirm or pay, and who ends for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.errors.streams import no_memory_left

LEAST_ROOM = 64
"""Part of the budget that may come before it is looked at again, however little is left: a look visits everybody."""


class Debtor(Protocol):
    """A stream, a call for clips, or a request that is not ended. num_waiting_bytes: held for its client, about."""

    refusal: StreamRefused | None

    @property
    def num_waiting_bytes(self) -> int: ...

    def refuse(self, refusal: StreamRefused) -> None:
        """End it, and let go of what waits."""

    def fail(self, error: Exception) -> None:
        """End it for a fault of the server's own."""


class Parked(Protocol):
    """The sessions that nobody hears of at present."""

    @property
    def num_parked(self) -> int: ...

    @property
    def num_waiting_bytes(self) -> int: ...

    def let_go(self, num_bytes: int) -> None:
        """Free so many bytes, if there are as many."""


class WaitingMemory:
    """What clients have sent and the engine has said, and waits: of streams, calls and parked sessions.

    Where it is more than may be, sessions that wait for their client give theirs up first, then those who hold most are
    ended. Lives on the event loop, but for num_bytes. on_begin: called when somebody begins to hold anything.
    """

    def __init__(self, most: int, streams: Mapping[int, Debtor], parked: Parked | None = None) -> None:
        """most: bytes of all together."""
        self.on_begin: Callable[[], object] = lambda: None
        self._most = most
        self._streams = streams
        self._calls: dict[int, Debtor] = {}
        self._requests: list[Debtor] = []
        self._parked = parked
        self._room = most  # left, as of the last look, less what has come since as far as it is noted

    @property
    def num_bytes(self) -> int:
        """Of all, also of those that are being ended. From any thread."""
        return self._num_parked_bytes + sum(each.num_waiting_bytes for each in self._debtors())

    @property
    def is_idle(self) -> bool:
        """Whether there is nobody who could hold anything."""
        held = self._streams or self._calls or self._requests
        return not (held or (self._parked is not None and self._parked.num_parked))

    def begin(self, number: int, call: Debtor) -> None:
        """A call counts too from now on. number: no other call's."""
        self._calls[number] = call
        self.on_begin()

    def end(self, number: int) -> None:
        """It is over."""
        del self._calls[number]

    @contextmanager
    def holding(self, request: Debtor) -> Iterator[None]:
        """A request that has come counts too, for the time of the block: its client has not ended its side yet."""
        self._requests.append(request)
        self.on_begin()
        self.note(request.num_waiting_bytes)
        try:
            yield
        finally:
            self._requests.remove(request)
            self.note(-request.num_waiting_bytes)

    def note(self, num_bytes: int) -> None:
        """So many more bytes wait, or fewer: what comes fast is bounded at once, and not at the next look."""
        self._room -= num_bytes
        if self._room < 0:
            self.bound()

    def bound(self) -> None:
        """Look at all, and end those who hold most, as far as it is more than may be."""
        live = [each for each in self._debtors() if each.refusal is None]
        parked, held = self._num_parked_bytes, sum(each.num_waiting_bytes for each in live)
        if parked + held > self._most and self._parked is not None:
            self._parked.let_go(parked + held - self._most)
            parked = self._num_parked_bytes
        live.sort(key=lambda each: each.num_waiting_bytes)
        while live and parked + held > self._most:
            debtor = live.pop()
            held -= debtor.num_waiting_bytes
            with alone(debtor):
                debtor.refuse(no_memory_left(self._most))
        self._room = max(self._most - parked - held, self._most // LEAST_ROOM)

    def _debtors(self) -> list[Debtor]:
        return [*list(self._streams.values()), *list(self._calls.values()), *list(self._requests)]

    @property
    def _num_parked_bytes(self) -> int:
        return 0 if self._parked is None else self._parked.num_waiting_bytes


@contextmanager
def alone(debtor: Debtor) -> Iterator[None]:
    """A fault of the server's own ends the one that it is about, and the others are looked at all the same."""
    try:
        yield
    except Exception as error:
        debtor.fail(error)
