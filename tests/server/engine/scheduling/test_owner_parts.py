"""How much edits take beyond their owners' parts of the machine."""

from __future__ import annotations

import pytest

from motiongen_server.engine.scheduling.owner_parts import OwnerParts
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.types import Owner, SessionKey
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import spec

EDITS_HZ = 60.0
EDITING, ASKING = Owner("editing"), Owner("asking")


@pytest.mark.parametrize("steps", [(2,) * 10, (4,) * 10, (10,) * 10, (2, 10) * 5])
def test_an_owners_edits_are_priced_at_the_steps_of_its_sessions(steps: tuple[int, ...]) -> None:
    """Ten sessions, each edited six times a second; there are two owners, each with half of the machine."""
    parts, prices = OwnerParts(FACTS), Prices(0.002, 0.004)
    for handle, num_steps in enumerate(steps, 1):
        parts.count(spec(SessionKey(1, handle), num_steps=num_steps, owner=EDITING), 1)
    parts.count(spec(SessionKey(2, 1), owner=ASKING), 1)
    each_s = 0.004 + 0.002 * sum(steps) / len(steps)
    edited, played = EDITS_HZ * each_s, len(steps) * each_s * FACTS.fps / FACTS.horizon
    assert parts.yielding(prices, {EDITING.name: EDITS_HZ}, ASKING) == pytest.approx(max(0.0, played + edited - 0.5))
    assert parts.yielding(prices, {EDITING.name: EDITS_HZ}, EDITING) == 0.0


def test_an_owners_part_follows_the_weight_of_its_latest_session() -> None:
    parts, prices = OwnerParts(FACTS), Prices(0.0, 0.01)
    parts.count(spec(SessionKey(2, 1), owner=ASKING), 1)
    parts.count(spec(SessionKey(1, 1), owner=EDITING), 1)
    half = parts.yielding(prices, {EDITING.name: EDITS_HZ})
    parts.count(spec(SessionKey(1, 2), owner=Owner(EDITING.name, 3.0)), 1)
    parts.count(spec(SessionKey(1, 1), owner=EDITING), -1)
    parts.count(spec(SessionKey(1, 3), owner=Owner(EDITING.name, 3.0)), 1)
    played = 0.01 * FACTS.fps / FACTS.horizon
    assert half == pytest.approx(EDITS_HZ * 0.01 + played - 0.5)
    assert parts.yielding(prices, {EDITING.name: 100.0}) == pytest.approx(1.0 + 2 * played - 0.75)
