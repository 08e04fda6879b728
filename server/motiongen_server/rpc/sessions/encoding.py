"""Has prompts encoded, once they are paid for, in turn with other prompts of their peer and of others."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

from motiongen_server.engine.types import Float32Array
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket
from motiongen_server.text.prompts import PromptEncoder
from motiongen_server.text.turns import Asker


async def encoded(
    prompts: PromptEncoder, texts: Sequence[str], asker: Asker, budget: Share | TokenBucket
) -> dict[str, Float32Array]:
    """The texts' embeddings (E,), once those that are not cached have been paid for.

    asker: the stream or call, and its peer. budget: charged for those that are not cached. Raises EventRefused.
    """
    num_unknown = sum(prompts.cached(text) is None for text in {*texts})
    if num_unknown:
        now = time.monotonic()
        budget.charge(num_unknown, now)
        await asyncio.sleep(budget.owed_s(now))  # a later caller owes more, and waits longer
    return await prompts.encode_all(texts, asker)
