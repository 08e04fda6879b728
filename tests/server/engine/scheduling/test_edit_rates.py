"""The rates at which edits begin windows are known within seconds, and forgotten when the edits end."""

import pytest

from motiongen_server.engine.scheduling.edit_rates import EditRates
from motiongen_server.engine.types import Owner

STUDIO, OTHER = Owner("studio"), Owner("other")


def seen(rates: EditRates, seconds: float, **hz: float) -> None:
    """Let owners' edits begin so many windows a second (hz), with an update four times a second."""
    for _ in range(round(4 * seconds)):
        for owner in (STUDIO, OTHER):
            rates.note(owner, hz.get(owner.name, 0.0) / 8)
            rates.note(owner, hz.get(owner.name, 0.0) / 8)
        rates.update(0.25)


def test_rates_are_those_of_each_owner_over_the_last_seconds() -> None:
    rates = EditRates()
    seen(rates, 4.0, studio=8.0)
    assert rates.by_owner == {"studio": pytest.approx(4.0)}, "half of it is known after four seconds"
    seen(rates, 60.0, studio=8.0, other=2.0)
    assert rates.by_owner == {"studio": pytest.approx(8.0, rel=1e-3), "other": pytest.approx(2.0, rel=1e-3)}
    seen(rates, 4.0, other=2.0)
    assert rates.by_owner == {"studio": pytest.approx(4.0, rel=1e-3), "other": pytest.approx(2.0, rel=1e-3)}
    seen(rates, 120.0)
    assert rates.by_owner == {}, "owners that no longer edit are forgotten"


def test_part_of_a_window_that_was_given_back_does_not_count() -> None:
    rates = EditRates()
    for _ in range(40):
        rates.note(STUDIO, 1.0)
        rates.note(STUDIO, -0.75)
        rates.update(0.25)
    assert rates.by_owner["studio"] == pytest.approx(1.0 * (1.0 - 0.5 ** (10.0 / 4.0)))


def test_rates_already_read_do_not_change_later() -> None:
    rates = EditRates()
    seen(rates, 4.0, studio=8.0)
    told = dict(before := rates.by_owner)
    seen(rates, 4.0, other=8.0)
    assert before == told
