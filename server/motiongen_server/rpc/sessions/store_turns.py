"""StoreTurns: who asks the store of snapshots next, for how long that may take, and what a store that fails means.

Clients that resume take turns as those who have prompts encoded do: peers go round, and of each its streams, however
much any of them asks. Where more wait than may, who has most gives up a place. None is told that its session is gone
because the store is busy or away: that is worth waiting for, though not for ever, since a client can open its session
anew from the frames it holds.
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
"""Who ask or wait to: as many as a server may have sessions, as all of another's come at once when that one is lost."""
TAKE_S = 2.0
"""How long a client that resumes waits for the store and its turn there, before it is told to come again."""
AWAY_S = 30.0
"""For so long a store that fails everybody is waited for: as long as a session is kept whose client is away."""

ASKED_AGAIN_S = 10.0
"""Longer than clients that wait leave between two attempts: after that a failure is the first of new ones."""

T = TypeVar("T")


class StoreAway(Exception):
    """The store has failed everybody for so long that nobody is to wait for it any more."""


class StoreTurns:
    """Used from the event loop only. clock: monotonic seconds."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._turns = Turns(TAKERS, MOST_ASKING)
        self._failing_since: float | None = None
        self._failed_at = 0.0

    async def take(self, asker: Asker, ask: Callable[[], Awaitable[T]]) -> T:
        """What `ask` gives, which asks the store, in a turn of its own.

        Raises EventRefused where there is no turn, or no answer, in time, and StoreAway.
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
        """The store has done what somebody needs of it."""
        self._failing_since = None

    def _failed(self, why: str) -> Exception:
        """The store has failed who had a turn. What that one is told."""
        now = self._clock()
        _log.info("a session cannot be asked for: %s", why)
        if self._failing_since is None or now - self._failed_at > ASKED_AGAIN_S:
            self._failing_since = now
        self._failed_at = now
        if now - self._failing_since > AWAY_S:
            return StoreAway(f"the store has not answered for {AWAY_S:g} s: {why}")
        return session_store_unavailable()
