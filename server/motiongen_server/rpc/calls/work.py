"""Measures and charges the event loop time of calls that take one request, as is done for streams."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.rpc.budgets.loop_time import Work
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.errors.too_many_calls import too_much_loop_time


def begin_work(peer: Peer) -> Callable[[], None]:
    """Count a peer among those that use the loop, before looking at its request; returns the function that ends this.

    Raises StreamRefused while the peer owes for the loop time that its streams and calls took.
    """
    peer.loop.enter(peer)
    if (owed_s := peer.loop_part.ahead_s(time.monotonic())) > 0:
        peer.loop.leave(peer)
        raise too_much_loop_time(owed_s, peer.kind)
    return partial(peer.loop.leave, peer)


@contextmanager
def work_for(peer: Peer) -> Iterator[None]:
    """Encloses work for a call that does not wait. It counts `REFUSED_TIMES` if it ends with a refusal."""
    work = Work(peer.loop, lambda seconds: peer.loop_part.charge(seconds, time.monotonic()))
    with work:
        work.num_events += 1
        try:
            yield
        except (EventRefused, StreamRefused):
            work.num_refused += 1
            raise
