"""The short form of `python -m tests.attack.cycles`: memory that closed sessions leave behind in the processes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.attack.cycles import MODELS, MOST_BYTES, SETTINGS, STEP_BYTES, Readings, judged, measure
from tests.attack.in_use import told
from tests.attack.server import attacked
from tests.waiting import LIMIT_S

CYCLES = 1800
MOST_RESIDENT_BYTES = 4096
"""Per cycle. Over so few cycles, a smaller leak cannot be told from the growth of the first seconds; over 100,000 it
can."""
MOST_BYTES_IN_USE = 1024
"""Per cycle. Memory in use at rest varies by about 50 KiB, with what is under way: over so few cycles, 460 each."""


async def test_resident_memory_does_not_grow_with_closed_sessions(tmp_path: Path) -> None:
    with attacked(tmp_path / "log", SETTINGS) as server:
        readings = await measure(server, CYCLES)
    assert max(readings.slopes()) < MOST_RESIDENT_BYTES
    assert server.exit_code == 0


@pytest.mark.timeout(3 * LIMIT_S)
@pytest.mark.parametrize(("model", "cycles"), [("none", CYCLES), ("built-in", 240)])
async def test_memory_in_use_does_not_grow_with_closed_sessions(tmp_path: Path, model: str, cycles: int) -> None:
    """More exact than resident memory: it finds a leak of 2 KB a cycle, in an engine or in the gateway."""
    module, settings = MODELS[model]
    with (
        told() as in_use,
        attacked(tmp_path / "log", SETTINGS + settings, module=module, environment=in_use.environment) as server,
    ):
        readings = await measure(server, cycles, in_use.bytes_of)
    print(readings.slopes(STEP_BYTES))
    assert max(readings.slopes(STEP_BYTES)) < MOST_BYTES_IN_USE
    assert server.exit_code == 0


def test_slope_ignores_single_steps_and_growth_in_the_first_half() -> None:
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
