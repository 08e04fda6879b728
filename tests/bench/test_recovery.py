"""After an overload, full service returns soon, in virtual time."""

from __future__ import annotations

import pytest

from motiongen_server.engine.types import ServiceTier
from tests.bench.recovery import recover

ASKED_S = 30.0


@pytest.mark.parametrize("times", [2.0, 5.0])
def test_crowd_held_for_long_soon_gets_full_service_again(times: float) -> None:
    found = recover(times, 60.0)
    assert found.lowest is ServiceTier.HOLD
    assert found.recovered_s is not None
    assert found.recovered_s < ASKED_S
    assert found.hero_underruns == 0
