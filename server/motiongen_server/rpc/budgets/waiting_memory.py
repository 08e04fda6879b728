"""WaitingMemory: limits the memory for what clients have not read, confirmed or paid for, of all clients together."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from operator import itemgetter
from typing import Protocol

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.errors.streams import no_memory_left

LEAST_ROOM = 64
"""1/64 of the budget may always come before the next look, however little is left: a look visits all holders."""


PARKED_PART = 4
"""Parked sessions together may keep 1/4 of the budget, whatever others hold. Most of them belong to clients that have
lost their connection, hold little, and are not to lose their sessions because others do not read or pay."""


class Debtor(Protocol):
    """A stream, a clip call, or a request whose client has not closed its side. num_waiting_bytes: roughly what is held
    for its client. peer_name: of the peer that it counts for."""

    refusal: StreamRefused | None

    @property
    def peer_name(self) -> str: ...

    @property
    def num_waiting_bytes(self) -> int: ...

    def refuse(self, refusal: StreamRefused) -> None:
        """End it, and free what waits."""

    def fail(self, error: Exception) -> None:
        """End it because of a fault of the server's own."""


class ParkedSession(Protocol):
    """A session that waits for its client."""

    @property
    def held_bytes(self) -> int: ...

    def let_go_of_places(self) -> None:
        """Free what can be spared without ending the session."""


class Parked(Protocol):
    """Sessions that have no stream at present."""

    @property
    def num_parked(self) -> int: ...

    @property
    def num_waiting_bytes(self) -> int: ...

    def let_go(self, num_bytes: int, sure_bytes: int) -> None:
        """Free that many bytes, as far as they hold more than the other number, by ending sessions if need be."""

    def by_peer(self) -> Mapping[str, Sequence[ParkedSession]]:
        """Those that wait for their client, by the peer that they count for, the smallest first."""


class WaitingMemory:
    """Accounts for clients' messages and engines' output that wait in memory: of streams, calls and parked sessions.

    Beyond the budget, parked sessions first give up what they hold beyond a part of it. Then the peer that has the most
    gives: first what its parked sessions can spare, then its streams and calls are ended, the largest first. A client
    with one large stream is not ended for others that hold as much as they may on many small ones.
    Lives on the event loop, except num_bytes. on_begin: called when a holder that may hold memory begins.
    """

    def __init__(self, most: int, streams: Mapping[int, Debtor], parked: Parked | None = None) -> None:
        """most: the budget in bytes, of all together."""
        self.on_begin: Callable[[], object] = lambda: None
        self._most = most
        self._streams = streams
        self._calls: dict[int, Debtor] = {}
        self._requests: list[Debtor] = []
        self._parked = parked
        self._room = most  # what the last look left, less what has been noted since

    @property
    def num_bytes(self) -> int:
        """Of all, including those that are being ended. May be read from any thread."""
        return self._num_parked_bytes + sum(each.num_waiting_bytes for each in self._debtors())

    @property
    def is_idle(self) -> bool:
        """Whether there is no holder at all."""
        held = self._streams or self._calls or self._requests
        return not (held or (self._parked is not None and self._parked.num_parked))

    def begin(self, number: int, call: Debtor) -> None:
        """Count a call from now on. number: unique among calls."""
        self._calls[number] = call
        self.on_begin()

    def end(self, number: int) -> None:
        """The call is over."""
        del self._calls[number]

    @contextmanager
    def holding(self, request: Debtor) -> Iterator[None]:
        """Count a request for the time of the block: it has come, but its client has not closed its side yet."""
        self._requests.append(request)
        self.on_begin()
        self.note(request.num_waiting_bytes)
        try:
            yield
        finally:
            self._requests.remove(request)
            self.note(-request.num_waiting_bytes)

    def note(self, num_bytes: int) -> None:
        """Note that more bytes wait, or fewer: bounds what comes fast at once, before the next regular look."""
        self._room -= num_bytes
        if self._room < 0:
            self.bound()

    def bound(self) -> None:
        """Look at all holders, and end those that hold the most until the rest fits into the budget."""
        live = [each for each in self._debtors() if each.refusal is None]
        held = sum(each.num_waiting_bytes for each in live)
        over = self._num_parked_bytes + held - self._most
        if over > 0 and self._parked is not None:
            self._parked.let_go(over, self._most // PARKED_PART)
            over = self._num_parked_bytes + held - self._most
        if over > 0:
            over -= self._given(live, over)
        self._room = max(-over, self._most // LEAST_ROOM)

    def _given(self, live: Sequence[Debtor], over: int) -> int:
        """Have the peers that hold the most give that many bytes, as far as possible. Returns how many they gave."""
        of_peers: defaultdict[str, list[tuple[int, Debtor]]] = defaultdict(list)
        for each in live:
            of_peers[each.peer_name].append((each.num_waiting_bytes, each))
        by_peer = {} if self._parked is None else self._parked.by_peer()
        parked = {name: list(sessions) for name, sessions in by_peer.items()}
        totals = Counter({name: sum(each.held_bytes for each in sessions) for name, sessions in parked.items()})
        for name, of_peer in of_peers.items():
            totals[name] += sum(num_bytes for num_bytes, _ in of_peer)
            of_peer.sort(key=itemgetter(0))
        given = 0
        while totals and given < over:
            name, freed = max(totals, key=totals.__getitem__), 0
            if parked.get(name):
                session = parked[name].pop()
                freed = freed_by(session, session.let_go_of_places)
            elif of_peers.get(name):
                freed, debtor = of_peers[name].pop()
                with alone(debtor):
                    debtor.refuse(no_memory_left(self._most))
            else:
                del totals[name]
                continue
            totals[name] -= freed
            given += freed
        return given

    def _debtors(self) -> list[Debtor]:
        return [*list(self._streams.values()), *list(self._calls.values()), *list(self._requests)]

    @property
    def _num_parked_bytes(self) -> int:
        return 0 if self._parked is None else self._parked.num_waiting_bytes


def freed_by(session: ParkedSession, free: Callable[[], object]) -> int:
    """Free what a session holds; returns how many bytes that were."""
    before = session.held_bytes
    free()
    return before - session.held_bytes


@contextmanager
def alone(debtor: Debtor) -> Iterator[None]:
    """Let a fault of the server's own end only the debtor it concerns, so that the others are still looked at."""
    try:
        yield
    except Exception as error:
        debtor.fail(error)
