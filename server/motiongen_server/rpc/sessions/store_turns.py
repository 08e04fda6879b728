"""StoreTurns: decides who asks the store of snapshots next, how long that may take, and what a failing store means.

Clients that resume take turns at the store as prompts do at the encoder: in rotation among peers, and among the streams
of each, however much any of them asks. If too many wait, the peer with the most gives up a place. No client is told
that its session is gone because the store is busy or away. The store is worth waiting for, but not for ever: a client
can open a new session from the frames that it holds.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import TypeVar

from motiongen_server.rpc.errors.events import session_store_busy, session_store_unavailable
from motiongen_server.rpc.sparing_log import SparingLog
from motiongen_server.snapshots.store import StoreFailed
from motiongen_server.snapshots.taker import TAKERS
from motiongen_server.text.turns import Asker, Place, PlaceLost, Turns

_log = SparingLog(logging.getLogger(__name__))

MOST_ASKING = 2048
"""Resumes under way or waiting: the sessions that a server may have, since all of a lost server's come at once."""
TAKE_S = 2.0
"""How long a client that resumes waits for its turn at the store and the answer, before it is told to retry."""
AWAY_S = 30.0
"""How long clients wait for a store that fails for all: as long as sessions are kept for clients that are away."""

ASKED_AGAIN_S = 10.0
"""More than waiting clients leave between two attempts: a failure that comes later begins a new series."""

T = TypeVar("T")


class StoreAway(Exception):
    """The store has failed for everybody for so long that no client is to wait for it any more."""


class StoreTurns:
    """Used from the event loop only. clock: monotonic seconds."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._turns = Turns(TAKERS, MOST_ASKING)
        self._failing_since: float | None = None
        self._failed_at = 0.0

    async def take(self, asker: Asker, ask: Callable[[], Awaitable[T]]) -> T:
        """Call `ask`, which asks the store, when it is the asker's turn; returns its result.

        Raises EventRefused if there is no turn or no answer in time, and StoreAway.
        """
        has_turn = False
        try:
            async with asyncio.timeout(TAKE_S):
                await self._turns.take(Place(asker))
                has_turn = True
                try:
                    return await ask()
                finally:
                    self._turns.give_back()
        except PlaceLost:
            raise session_store_busy() from None
        except (StoreFailed, TimeoutError) as error:
            if not has_turn:
                raise session_store_busy() from error
            raise self._failed(str(error) or f"it took more than {TAKE_S:g} s") from error

    def note_answer(self) -> None:
        """The store has served a request completely."""
        self._failing_since = None

    def _failed(self, why: str) -> Exception:
        """The store has failed in somebody's turn. Returns the exception for the asker."""
        now = self._clock()
        _log.info("the store could not be asked for a session: %s", why)
        if self._failing_since is None or now - self._failed_at > ASKED_AGAIN_S:
            self._failing_since = now
        self._failed_at = now
        if now - self._failing_since > AWAY_S:
            return StoreAway(f"the store has not answered for {AWAY_S:g} s: {why}")
        return session_store_unavailable()
