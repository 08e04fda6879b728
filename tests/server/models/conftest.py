"""The fixture of the tests of models."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from tests.server.models.model_shop import LIMIT_S, Shop, Stage, running


@pytest.fixture
async def stage() -> AsyncIterator[Stage]:
    shop = Shop()
    async with asyncio.timeout(2 * LIMIT_S), running(shop) as stage:
        yield stage
