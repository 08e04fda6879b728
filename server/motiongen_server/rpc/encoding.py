"""A prompt's way to the encoder: paid for, and in turn with those of its peer and of others."""

from __future__ import annotations

import asyncio
import time

from motiongen_server.engine.types import Float32Array
from motiongen_server.rpc.token_bucket import Share, TokenBucket
from motiongen_server.text.prompts import PromptEncoder
from motiongen_server.text.turns import Asker


async def encoded(prompts: PromptEncoder, text: str, asker: Asker, budget: Share | TokenBucket) -> Float32Array:
    """A text's embedding (E,). One that is not known waits until that is paid for.

    asker: the stream or call, and its peer. budget: what it is charged to. Raises EventRefused.
    """
    embedding = prompts.cached(text)
    if embedding is not None:
        return embedding
    now = time.monotonic()
    budget.charge(1.0, now)
    await asyncio.sleep(budget.owed_s(now))  # whoever comes later owes more, and waits longer
    return await prompts.encode(text, asker)
