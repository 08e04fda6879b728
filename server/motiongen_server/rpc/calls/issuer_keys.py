"""Waits, on the event loop, for the keys with which a caller's token is checked."""

from __future__ import annotations

import asyncio

from motiongen_server.identity.callers import Callers, Metadata
from motiongen_server.identity.key_fetch import WITHIN_S


async def keys_for(callers: Callers, metadata: Metadata) -> None:
    """Wait for keys that the token needs, if they are being fetched. If none come, the known keys decide.

    If this call is cancelled, others that wait for the same keys are not affected.
    """
    wanted = callers.wanted(metadata)
    if wanted is not None:
        await asyncio.wait({asyncio.wrap_future(wanted)}, timeout=WITHIN_S)
