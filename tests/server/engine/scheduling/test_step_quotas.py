"""Quotas of steps: saved up for a second, overdrawn by a second, forgotten when full."""

from motiongen_server.engine.scheduling.step_quotas import StepQuotas
from motiongen_server.engine.types import NOBODY, Owner

STUDIO = Owner("studio", steps_per_s=40.0)


def test_one_second_of_steps_is_saved_up_and_refilled_at_the_quotas_rate() -> None:
    quotas = StepQuotas()
    for _ in range(10):
        assert quotas.ready_at(STUDIO, 5.0) == 5.0
        quotas.charge(STUDIO, 4, 5.0)
    assert quotas.ready_at(STUDIO, 5.0) == 5.0 + 1 / 40
    assert quotas.ready_at(STUDIO, 5.1) == 5.1
    quotas.charge(STUDIO, 80, 100.0)  # however long it waited, it had saved up 40
    assert quotas.ready_at(STUDIO, 100.0) == 100.0 + 41 / 40


def test_owner_owes_at_most_one_second_of_steps() -> None:
    quotas = StepQuotas()
    for _ in range(100):
        quotas.charge(STUDIO, 4, 0.0)
    assert quotas.ready_at(STUDIO, 0.0) == 41 / 40


def test_window_that_never_begins_costs_nothing_once_given_back() -> None:
    quotas = StepQuotas()
    for _ in range(1000):
        quotas.give_back(STUDIO, quotas.charge(STUDIO, 4, 0.0))
    assert quotas.take_taken(0.0) == ()
    quotas.charge(STUDIO, 39, 0.0)
    assert quotas.ready_at(STUDIO, 0.0) == 0.0, "one step of 40 is left"
    quotas.charge(STUDIO, 4, 0.0)
    assert quotas.ready_at(STUDIO, 0.0) == 4 / 40
    quotas.note_begun(STUDIO, 4)
    assert quotas.take_taken(0.0) == ((STUDIO, 4),)


def test_steps_that_were_not_charged_are_not_given_back() -> None:
    quotas = StepQuotas()
    charged = [quotas.charge(STUDIO, 4, 0.0) for _ in range(100)]
    assert sum(charged) == 80, "what was saved up, and the most that an owner may owe"
    for each in charged[20:]:
        quotas.give_back(STUDIO, each)
    assert quotas.ready_at(STUDIO, 0.0) == 41 / 40


def test_steps_given_back_do_not_raise_savings_above_one_second() -> None:
    quotas = StepQuotas()
    charged = quotas.charge(STUDIO, 40, 0.0)
    assert quotas.ready_at(STUDIO, 10.0) == 10.0
    quotas.give_back(STUDIO, charged)
    quotas.charge(STUDIO, 40, 10.0)
    assert quotas.ready_at(STUDIO, 10.0) == 10.0 + 1 / 40


def test_steps_given_back_to_a_forgotten_owner_open_no_account() -> None:
    quotas = StepQuotas()
    quotas.give_back(STUDIO, 4.0)
    assert quotas.num_accounts == 0


def test_owner_without_a_quota_never_waits_and_has_no_account() -> None:
    quotas = StepQuotas()
    assert quotas.charge(NOBODY, 1_000_000, 0.0) == 0.0
    quotas.note_begun(NOBODY, 1_000_000)
    assert quotas.take_taken(0.0) == ()
    assert quotas.ready_at(NOBODY, 0.0) == 0.0
    assert quotas.num_accounts == 0


def test_changed_quota_applies_at_once() -> None:
    quotas = StepQuotas()
    quotas.charge(STUDIO, 41, 0.0)
    assert quotas.ready_at(Owner("studio", steps_per_s=400.0), 0.0) == 2 / 400


def test_accounts_of_owners_that_have_gone_are_dropped() -> None:
    quotas = StepQuotas()
    for number in range(10_000):
        quotas.charge(Owner(f"{number}", steps_per_s=10.0), 4, float(number))
    assert quotas.num_accounts <= 257


def test_steps_taken_by_other_engines_are_owed_in_full() -> None:
    quotas = StepQuotas()
    quotas.note_elsewhere(((STUDIO, 240),))
    assert quotas.take_taken(0.0) == ()
    assert quotas.ready_at(STUDIO, 0.0) == 201 / 40
    charged = quotas.charge(STUDIO, 4, 0.0)
    assert charged == 0.0, "it already owes more than an owner may owe"
    quotas.give_back(STUDIO, charged)
    assert quotas.ready_at(STUDIO, 0.0) == 201 / 40


def test_time_that_goes_back_neither_takes_steps_nor_gives_any_twice() -> None:
    quotas = StepQuotas()
    quotas.charge(STUDIO, 80, 10.0)
    assert quotas.ready_at(STUDIO, 9.0) == 9.0 + 41 / 40
    assert quotas.ready_at(STUDIO, 10.0) == 10.0 + 41 / 40
    assert quotas.ready_at(STUDIO, 10.5) == 10.5 + 21 / 40


def test_owner_with_partly_used_savings_is_not_forgotten() -> None:
    quotas = StepQuotas()
    quotas.charge(STUDIO, 20, 0.0)
    for number in range(300):
        quotas.charge(Owner(f"{number}", steps_per_s=40.0), 4, 0.0)
    quotas.charge(STUDIO, 20, 0.0)
    assert quotas.ready_at(STUDIO, 0.0) == 1 / 40, "its savings are used up"
