"""The short form of `make attack`: what did most harm, each for a moment. The long form judges latency too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.attack.__main__ import ATTACKS
from tests.attack.attack import run
from tests.waiting import LIMIT_S

SECONDS = 1.5
ANY_MS = 30_000.0
"""How long an edit takes on a busy machine is not what this judges."""


@pytest.mark.parametrize("kind", ["empty_events", "huge_messages", "liars", "silent_streams", "half_open_calls"])
async def test_neighbours_are_served_in_full_and_the_server_ends_with_0(kind: str, tmp_path: Path) -> None:
    attack = next(attack for attack in ATTACKS if attack.kind == kind)
    attack = replace(
        attack, clients=1, missed=0.5, edit_ms=ANY_MS, newcomer_s=ANY_MS, health_s=LIMIT_S, takes_places=True
    )
    result = await run(attack, SECONDS, tmp_path / "log")
    assert result.faults == []
    assert result.noticed.frames > 0
