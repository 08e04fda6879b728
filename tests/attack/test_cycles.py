"""The short form of `python -m tests.attack.cycles`: what sessions leave behind in the processes' memory."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.attack.cycles import MODELS, MOST_BYTES, SETTINGS, Readings, judged, measure
from tests.attack.in_use import told
from tests.attack.server import attacked
from tests.waiting import LIMIT_S

CYCLES = 1800
MOST_RESIDENT_BYTES = 4096
"""A cycle. So few cycles are told from what a process settles to in the first seconds by nothing finer; 100,000 are."""
MOST_BYTES_IN_USE = 1024
"""A cycle. What is in use at rest goes up and down by some 50 KiB, by what is on its way, by which so few make 460."""

STEP_BYTES = 128 << 10
"""Batches of a size that there was not before have megabytes kept for the next, once. A leak of 2 KB a cycle is 24 KB
more at each reading with the model. One of seldom, long blocks is found by longer runs only."""


async def test_sessions_that_come_and_go_leave_no_memory_behind(tmp_path: Path) -> None:
    with attacked(tmp_path / "log", SETTINGS) as server:
        readings = await measure(server, CYCLES)
    assert max(readings.slopes()) < MOST_RESIDENT_BYTES
    assert server.exit_code == 0


@pytest.mark.timeout(3 * LIMIT_S)
@pytest.mark.parametrize(("model", "cycles"), [("none", CYCLES), ("built-in", 240)])
async def test_and_nothing_in_use(tmp_path: Path, model: str, cycles: int) -> None:
    """Finer: 2 KB a cycle are found, in an engine or in the gateway."""
    module, settings = MODELS[model]
    with (
        told() as in_use,
        attacked(tmp_path / "log", SETTINGS + settings, module=module, environment=in_use.environment) as server,
    ):
        readings = await measure(server, cycles, in_use.bytes_of)
    print(readings.slopes(STEP_BYTES))
    assert max(readings.slopes(STEP_BYTES)) < MOST_BYTES_IN_USE
    assert server.exit_code == 0


def test_growth_is_told_from_a_step_and_from_what_comes_before_the_half() -> None:
    cycles = list(range(0, 2000, 100))
    settles = [max(0, 1000 - count) * 50 for count in cycles]
    step = [1 << 20 if count == 1500 else 0 for count in cycles]
    grows = [(MOST_BYTES + 10) * count for count in cycles]
    still = Readings(cycles, [[up + odd, up] for up, odd in zip(settles, step, strict=True)])
    assert still.slopes() == [0.0, 0.0]
    assert judged(still) == ("bytes per cycle, gateway and engines: 0, 0; allowed: 50", True)
    late = Readings([0, 10, 20, 30, 40, 50, 60, 70], [[0]] * 4 + [[0], [5 << 20], [(5 << 20) + 20], [(5 << 20) + 40]])
    assert late.slopes()[0] > 50_000
    assert late.slopes(STEP_BYTES) == [2.0]
    growing = Readings(cycles, [[0, grown + odd] for grown, odd in zip(grows, step, strict=True)])
    assert judged(growing) == ("bytes per cycle, gateway and engines: 0, 60; allowed: 50", False)
