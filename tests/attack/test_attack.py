"""The short form of `make attack`: the most harmful attacks, briefly. The long form judges latency too.

So that a busy machine does not matter, neighbours are compared with themselves before the attack, on the same server.
`test_account.py` judges how much a flood is granted; other load cannot raise its figures.
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
"""Latency is not judged here, since it depends on other load."""
MORE_MISSED = 0.1
MORE_BEHIND = 0.6
"""By how much the share of frames that the neighbours are behind may grow. Since they hold two seconds of frames, a
neighbour that gets none is behind before it misses one."""


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
async def test_neighbours_play_as_before_under_attack_and_the_server_exits_with_0(kind: str, tmp_path: Path) -> None:
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
