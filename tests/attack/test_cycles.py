"""The short form of `python -m tests.attack.cycles`: what sessions leave behind in the processes' memory."""

from __future__ import annotations

from pathlib import Path

from tests.attack.cycles import SETTINGS, measure
from tests.attack.server import attacked

CYCLES = 1800
MOST_BYTES = 4096
"""A cycle. So few cycles are told from what a process settles to in the first seconds by nothing finer; 100,000 are."""


async def test_sessions_that_come_and_go_leave_no_memory_behind(tmp_path: Path) -> None:
    with attacked(tmp_path / "log", SETTINGS) as server:
        slopes = await measure(server, CYCLES)
    assert max(slopes) < MOST_BYTES
    assert server.exit_code == 0
