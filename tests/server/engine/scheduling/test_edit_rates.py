"""How many windows a second edits begin is seen within seconds, and forgotten when they end."""

import pytest

from motiongen_server.engine.scheduling.edit_rates import EditRates
from motiongen_server.engine.types import Owner

STUDIO, OTHER = Owner("studio"), Owner("other")


def seen(rates: EditRates, seconds: float, **hz: float) -> None:
    """Let owners' edits begin so many windows a second, looked at four times a second."""
    for _ in range(round(4 * seconds)):
        for owner in (STUDIO, OTHER):
            rates.note(owner, hz.get(owner.name, 0.0) / 8)
            rates.note(owner, hz.get(owner.name, 0.0) / 8)
        rates.update(0.25)


def test_they_are_those_of_each_owner_of_the_last_seconds() -> None:
    rates = EditRates()
    seen(rates, 4.0, studio=8.0)
    assert rates.by_owner == {"studio": pytest.approx(4.0)}, "half of it is known after four seconds"
    seen(rates, 60.0, studio=8.0, other=2.0)
    assert rates.by_owner == {"studio": pytest.approx(8.0, rel=1e-3), "other": pytest.approx(2.0, rel=1e-3)}
    seen(rates, 4.0, other=2.0)
    assert rates.by_owner == {"studio": pytest.approx(4.0, rel=1e-3), "other": pytest.approx(2.0, rel=1e-3)}
    seen(rates, 120.0)
    assert rates.by_owner == {}, "those who edit no more are forgotten"


def test_a_window_that_was_let_go_of_did_not_count() -> None:
    rates = EditRates()
    for _ in range(40):
        rates.note(STUDIO, 1.0)
        rates.note(STUDIO, -0.75)
        rates.update(0.25)
    assert rates.by_owner["studio"] == pytest.approx(1.0 * (1.0 - 0.5 ** (10.0 / 4.0)))


def test_what_was_told_is_not_changed_by_what_comes_later() -> None:
    rates = EditRates()
    seen(rates, 4.0, studio=8.0)
    told = dict(before := rates.by_owner)
    seen(rates, 4.0, other=8.0)
    assert before == told
