"""The short form of `make attack`: what did most harm, each for a moment. The long form judges latency too.

How busy the machine is must not matter, so neighbours are compared with themselves before the attack, on the same
server. What a flood may have of the server is judged in `test_account.py`, whose figures no load can make worse.
"""

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
MORE_MISSED = 0.1
MORE_BEHIND = 0.6
"""Of their frames, than before: two seconds of them are in hand, so who gets nothing is behind before he misses one."""


@pytest.mark.parametrize(
    "kind",
    [
        "empty_events",
        "huge_messages",
        "liars",
        "silent_streams",
        "half_open_calls",
        "unreadable_names",
        "resets",
        "forbidden_frames",
        "expired_tokens",
    ],
)
async def test_neighbours_are_served_as_before_and_the_server_ends_with_0(kind: str, tmp_path: Path) -> None:
    attack = next(attack for attack in ATTACKS if attack.kind == kind)
    token_s = None if attack.token_s is None else SECONDS / 2
    attack = replace(
        attack, missed=1.0, edit_ms=ANY_MS, newcomer_s=ANY_MS, health_s=LIMIT_S, takes_places=True, token_s=token_s
    )
    result = await run(attack, SECONDS, tmp_path / "log", quiet_s=SECONDS)
    assert result.faults == []
    before, noticed = result.suffered.quiet_noticed, result.noticed
    assert before is not None
    assert noticed.frames > 0
    assert noticed.missed <= before.missed + MORE_MISSED
    assert noticed.behind <= before.behind + MORE_BEHIND
