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


def test_a_window_that_never_begins_has_cost_what_it_is_given_back() -> None:
    quotas = StepQuotas()
    for _ in range(1000):
        quotas.give_back(STUDIO, quotas.charge(STUDIO, 4, 0.0))
    assert quotas.take_taken(0.0) == ()
    quotas.charge(STUDIO, 39, 0.0)
    assert quotas.ready_at(STUDIO, 0.0) == 0.0, "one of 40 is left"
    quotas.charge(STUDIO, 4, 0.0)
    assert quotas.ready_at(STUDIO, 0.0) == 4 / 40
    quotas.note_begun(STUDIO, 4)
    assert quotas.take_taken(0.0) == ((STUDIO, 4),)


def test_what_nobody_was_charged_is_not_given_back() -> None:
    quotas = StepQuotas()
    charged = [quotas.charge(STUDIO, 4, 0.0) for _ in range(100)]
    assert sum(charged) == 80, "what was saved up, and what anybody may owe"
    for each in charged[20:]:
        quotas.give_back(STUDIO, each)
    assert quotas.ready_at(STUDIO, 0.0) == 41 / 40


def test_no_more_than_a_seconds_steps_are_saved_up_by_what_is_given_back() -> None:
    quotas = StepQuotas()
    charged = quotas.charge(STUDIO, 40, 0.0)
    assert quotas.ready_at(STUDIO, 10.0) == 10.0
    quotas.give_back(STUDIO, charged)
    quotas.charge(STUDIO, 40, 10.0)
    assert quotas.ready_at(STUDIO, 10.0) == 10.0 + 1 / 40


def test_what_is_given_back_to_an_owner_that_was_forgotten_is_saved_up_already() -> None:
    quotas = StepQuotas()
    quotas.give_back(STUDIO, 4.0)
    assert quotas.num_accounts == 0


def test_without_a_quota_nothing_is_kept_and_nobody_waits() -> None:
    quotas = StepQuotas()
    assert quotas.charge(NOBODY, 1_000_000, 0.0) == 0.0
    quotas.note_begun(NOBODY, 1_000_000)
    assert quotas.take_taken(0.0) == ()
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


def test_what_was_taken_elsewhere_is_owed_in_full_whatever_begins_here() -> None:
    quotas = StepQuotas()
    quotas.note_elsewhere(((STUDIO, 240),))
    assert quotas.take_taken(0.0) == ()
    assert quotas.ready_at(STUDIO, 0.0) == 201 / 40
    charged = quotas.charge(STUDIO, 4, 0.0)
    assert charged == 0.0, "it owes as much as anybody may, and more"
    quotas.give_back(STUDIO, charged)
    assert quotas.ready_at(STUDIO, 0.0) == 201 / 40


def test_a_clock_that_went_back_takes_nothing_and_gives_nothing_twice() -> None:
    quotas = StepQuotas()
    quotas.charge(STUDIO, 80, 10.0)
    assert quotas.ready_at(STUDIO, 9.0) == 9.0 + 41 / 40


def test_who_has_used_a_part_of_what_was_saved_up_is_not_forgotten() -> None:
    quotas = StepQuotas()
    quotas.charge(STUDIO, 20, 0.0)
    for number in range(300):
        quotas.charge(Owner(f"{number}", steps_per_s=40.0), 4, 0.0)
    quotas.charge(STUDIO, 20, 0.0)
    assert quotas.ready_at(STUDIO, 0.0) == 1 / 40, "what it saved up is used up"
