"""Waiting, on the event loop, for the keys that a caller's token is checked with."""

from __future__ import annotations

import asyncio

from motiongen_server.identity.callers import Callers, Metadata
from motiongen_server.identity.key_fetch import WITHIN_S


async def keys_for(callers: Callers, metadata: Metadata) -> None:
    """Let keys arrive that are being fetched, where the token needs them. Without them it is decided by what is known.

    Others that wait for the same are not disturbed where this call is cancelled.
    """
    wanted = callers.wanted(metadata)
    if wanted is not None:
        await asyncio.wait({asyncio.wrap_future(wanted)}, timeout=WITHIN_S)
