"""Prompts are paid for before they are encoded: those that are not in the cache, once each, and no others."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from motiongen_server.engine.types import Float32Array
from motiongen_server.rpc.budgets.token_bucket import TokenBucket
from motiongen_server.rpc.sessions import encoding
from motiongen_server.rpc.sessions.encoding import encoded
from motiongen_server.text.prompts import PromptEncoder
from motiongen_server.text.turns import Asker

ASKER = Asker("studio", 3)


class Encoder:
    """Has some texts in its cache. heard: the texts that it was asked to encode, and for whom."""

    def __init__(self, *known: str) -> None:
        self._known = known
        self.heard: list[tuple[tuple[str, ...], Asker]] = []

    def cached(self, text: str) -> Float32Array | None:
        return np.ones(2, np.float32) if text in self._known else None

    async def encode_all(self, texts: tuple[str, ...], asker: Asker) -> dict[str, Float32Array]:
        self.heard.append((tuple(texts), asker))
        return {text: np.ones(2, np.float32) for text in texts}


@pytest.mark.parametrize(
    ("texts", "charged"),
    [((), 0), (("walk", "walk"), 0), (("run",), 1), (("walk", "run", "run", "hop"), 2), (("a", "b", "c"), 3)],
)
async def test_texts_that_are_not_cached_are_charged_once_each(
    texts: tuple[str, ...], charged: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[float] = []

    async def wait(seconds: float) -> None:
        waited.append(seconds)

    monkeypatch.setattr(encoding.asyncio, "sleep", wait)
    monkeypatch.setattr(encoding.time, "monotonic", lambda: 5.0)
    budget, encoder = TokenBucket(2.0, 5.0), Encoder("walk")
    found = await encoded(cast(PromptEncoder, encoder), texts, ASKER, budget)
    assert set(found) == set(texts)
    assert encoder.heard == [(texts, ASKER)]
    assert budget.left(5.0) == max(0, 2 - charged)
    assert waited == ([max(0.0, (charged - 2) / 2.0)] if charged else []), "the budget allows two at once"
