"""Quotas of steps: saved up for a second, overdrawn by a second, forgotten when full."""

from motiongen_server.engine.scheduling.step_quotas import StepQuotas
from motiongen_server.engine.types import NOBODY, Owner

STUDIO = Owner("studio", steps_per_s=40.0)


def test_steps_are_saved_up_for_a_second_and_come_back_at_the_rate() -> None:
    quotas = StepQuotas()
    for _ in range(10):
        assert quotas.ready_at(STUDIO, 5.0) == 5.0
        quotas.charge(STUDIO, 4, 5.0)
    assert quotas.ready_at(STUDIO, 5.0) == 5.0 + 1 / 40
    assert quotas.ready_at(STUDIO, 5.1) == 5.1
    quotas.charge(STUDIO, 80, 100.0)  # however long it waited, it had 40
    assert quotas.ready_at(STUDIO, 100.0) == 100.0 + 41 / 40


def test_no_owner_owes_more_than_a_second() -> None:
    quotas = StepQuotas()
    for _ in range(100):
        quotas.charge(STUDIO, 4, 0.0)
    assert quotas.ready_at(STUDIO, 0.0) == 41 / 40


def test_without_a_quota_nothing_is_kept_and_nobody_waits() -> None:
    quotas = StepQuotas()
    quotas.charge(NOBODY, 1_000_000, 0.0)
    assert quotas.ready_at(NOBODY, 0.0) == 0.0
    assert quotas.num_accounts == 0


def test_a_quota_that_changes_holds_at_once() -> None:
    quotas = StepQuotas()
    quotas.charge(STUDIO, 41, 0.0)
    assert quotas.ready_at(Owner("studio", steps_per_s=400.0), 0.0) == 2 / 400


def test_owners_that_have_gone_are_forgotten() -> None:
    quotas = StepQuotas()
    for number in range(10_000):
        quotas.charge(Owner(f"{number}", steps_per_s=10.0), 4, float(number))
    assert quotas.num_accounts <= 257
