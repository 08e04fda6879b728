"""Shares of owners: rows go by weight while there is too much to do, and otherwise as without owners."""

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.owed_rows import OwedRows
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.types import Owner, Priority
from tests.server.engine.scheduling.scheduled import LATER, window_job

HERO, NEAR, CROWD, BATCH = Priority


def _scheduler(max_rows: int, **jobs_of: tuple[int, Priority, float]) -> Scheduler:
    """jobs_of: by owner, how many jobs of which class, and the owner's weight."""
    scheduler = Scheduler(CostTable.assumed(1.0), max_rows)
    for index, (name, (count, priority, weight)) in enumerate(jobs_of.items()):
        for number in range(count):
            job = replace(window_job(1000 * index + number, priority), owner=Owner(name, weight))
            scheduler.add(job, 1)
    return scheduler


def _rows_by_owner(scheduler: Scheduler, num_steps: int) -> Counter[str]:
    rows: Counter[str] = Counter()
    for _ in range(num_steps):
        rows.update(held.job.owner.name for held in scheduler.schedule(LATER))
    return rows


@pytest.mark.parametrize("classes", [(NEAR, NEAR), (HERO, CROWD), (CROWD, HERO)])
def test_rows_are_shared_by_owner_weight_whatever_the_classes(classes: tuple[Priority, Priority]) -> None:
    scheduler = _scheduler(12, large=(100, classes[0], 1.0), small=(30, classes[1], 2.0))
    rows = _rows_by_owner(scheduler, 300)
    assert rows.total() == 3600
    assert rows["small"] == pytest.approx(2400, abs=24)


@given(st.integers(1, 32), st.lists(st.sampled_from([0.5, 1.0, 2.0]), min_size=2, max_size=4))
def test_owner_gets_the_fractions_of_rows_in_its_share_too(max_rows: int, weights: list[float]) -> None:
    """For example, a third of eight rows is more than two rows."""
    scheduler = _scheduler(max_rows, **{f"o{n}": (32, HERO, weight) for n, weight in enumerate(weights)})
    rows, num_steps = _rows_by_owner(scheduler, 60), 60
    for number, weight in enumerate(weights):
        of_share = weight / sum(weights) * max_rows * num_steps
        assert rows[f"o{number}"] >= of_share - max_rows - 2, "in the first step no owner is owed anything yet"


def test_owner_below_its_share_gets_all_it_asks_for_and_others_the_rest() -> None:
    assert _rows_by_owner(_scheduler(12, large=(100, HERO, 1.0), small=(3, CROWD, 1.0)), 101) == {
        "large": 909 + 3,  # in the first step no owner is owed anything yet
        "small": 300,
    }


def test_owner_without_competitors_gets_every_row() -> None:
    assert _rows_by_owner(_scheduler(4, only=(9, CROWD, 0.1)), 10) == {"only": 40}


def test_shares_of_owners_do_not_apply_while_there_is_time_for_all() -> None:
    scheduler = _scheduler(12, large=(100, HERO, 1.0), small=(12, NEAR, 9.0))
    for _ in range(10):
        classes = Counter(held.job.priority for held in scheduler.schedule(LATER - 10_000.0))
        assert classes[HERO] >= 8  # the other rows are the share of class NEAR


def test_jobs_of_one_owner_are_ordered_by_class_and_deadline() -> None:
    scheduler = _scheduler(4, large=(100, HERO, 1.0))
    for job in (
        window_job(5001, CROWD, LATER + 1),
        window_job(5002, NEAR, LATER + 9),
        window_job(5003, NEAR, LATER + 8),
    ):
        scheduler.add(replace(job, owner=Owner("small")), 1)
    scheduler.schedule(LATER)
    assert [held.job.job_id for held in scheduler.schedule(LATER) if held.job.owner.name == "small"] == [5003, 5002]


def test_background_windows_have_no_owner_share() -> None:
    scheduler = _scheduler(8, large=(100, HERO, 1.0))
    for number in range(20):
        scheduler.add(replace(window_job(5000 + number, CROWD), owner=Owner("clips"), background=True), 1)
    rows = _rows_by_owner(scheduler, 100)
    assert rows["clips"] < 0.15 * rows.total()  # the share of the class alone


def test_unused_share_of_an_owner_is_not_saved_up() -> None:
    scheduler = _scheduler(4, large=(50, HERO, 1.0), small=(1, NEAR, 1.0))
    _rows_by_owner(scheduler, 1000)
    for number in range(20):
        scheduler.add(replace(window_job(5000 + number, NEAR), owner=Owner("small")), 1)
    assert _rows_by_owner(scheduler, 10)["small"] <= 22


@given(
    st.integers(1, 40),
    st.lists(st.tuples(st.integers(1, 40), st.sampled_from([HERO, NEAR, CROWD])), min_size=2, max_size=6),
)
def test_owner_waits_no_longer_than_its_share_allows(max_rows: int, crowds: list[tuple[int, Priority]]) -> None:
    """The only job of an owner waits at most for a step for each other owner, and for those owed to classes."""
    scheduler = _scheduler(max_rows, **{f"o{n}": (*crowd, 1.0) for n, crowd in enumerate(crowds)})
    scheduler.add(replace(window_job(999_999, CROWD), owner=Owner("small")), 1)
    waited = longest = 0
    for _ in range(100):
        batch = scheduler.schedule(LATER)
        waited = 0 if any(held.job.owner.name == "small" for held in batch) else waited + 1
        longest = max(longest, waited)
    owners = len(crowds) + 1
    assert longest <= 2 * owners / min(max_rows, owners) + 4


def test_rows_not_used_while_there_was_time_are_not_owed_later() -> None:
    def chosen(times: int) -> list[int]:
        scheduler = _scheduler(12, large=(100, HERO, 1.0), small=(12, NEAR, 9.0))
        for _ in range(times):
            scheduler.schedule(LATER - 10_000.0)
            scheduler._owed.forget()  # what is owed to classes
        return [held.job.job_id for held in scheduler.schedule(LATER)]

    assert chosen(50) == chosen(0)


def test_background_windows_do_not_use_up_their_owners_share() -> None:
    scheduler = _scheduler(12, large=(100, HERO, 1.0), small=(100, HERO, 1.0))
    for number in range(20):
        scheduler.add(replace(window_job(5000 + number, HERO), owner=Owner("small"), background=True), 1)
    rows: Counter[tuple[str, bool]] = Counter()
    for _ in range(400):
        rows.update((held.job.owner.name, held.job.background) for held in scheduler.schedule(LATER))
    assert rows["small", True] == pytest.approx(0.05 * rows.total(), rel=0.1)
    assert rows["small", False] == pytest.approx(rows["large", False], abs=24)


def test_whole_owed_rows_are_listed_largest_debt_first() -> None:
    owed: OwedRows[str] = OwedRows()
    shares = {"a": 0.1, "b": 0.6, "c": 0.3}
    assert owed.whole() == []
    owed.settle(4, shares, {}, "abc")
    assert owed.whole() == [("b", 2), ("c", 1)]
    owed.settle(4, shares, {"b": 3}, "abc")
    assert owed.whole() == [("c", 2), ("b", 1)], "b has had more than its share of this step"
    owed.settle(10, shares, {"b": 1, "c": 1}, "ab")
    assert owed.whole() == [("b", 6), ("a", 1)], "nothing is owed to c, which does not wait"
    owed.settle(10, shares, {"a": 1}, "ab")
    assert owed.whole() == [("b", 8), ("a", 1)], "no more than two rows are kept beyond a step's share"
    owed.forget()
    assert owed.whole() == []
