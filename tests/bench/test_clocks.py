"""The processor clock counts work and sleeps, but not waits for a core."""

from __future__ import annotations

from tests.bench.clocks import ProcessorClock


def test_sleeping_advances_the_processor_clock_at_once() -> None:
    clock = ProcessorClock()
    before = clock.now()
    clock.sleep(3600.0)
    assert 3600.0 <= clock.now() - before < 3660.0
    clock.sleep(0.0)
    while clock.now() - before < 3600.01:  # busy work: the loop ends only if it counts
        pass
