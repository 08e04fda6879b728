import itertools

import pytest

from motiongen_server.engine.scheduling.degradation import Degradation, DegradationLimits, Demand
from motiongen_server.engine.scheduling.levels import FULL
from motiongen_server.engine.types import Priority, ServiceTier
from tests.server.engine.fakes import FACTS
from tests.server.engine.scheduling.degrading import ALL, EVERY_S, LEVELS, Day

HERO, NEAR, CROWD, BATCH = Priority


def test_no_class_is_degraded_while_the_machine_keeps_up() -> None:
    day = Day()
    assert day.pass_time(60.0, load=0.9, late=0.01) == []
    assert all(day.degradation.level(priority) is FULL for priority in Priority)


@pytest.mark.parametrize("trouble", [{"load": 0.97}, {"late": 0.05}])
def test_under_overload_the_least_urgent_classes_go_down_a_level_every_2_s(trouble: dict[str, float]) -> None:
    day = Day()
    assert day.pass_time(2.0, **trouble) == [BATCH]
    assert day.pass_time(2.0, **trouble) == [CROWD]
    assert (day.levels(), day.shed) == ([0, 0, 1, 1], 0)
    assert day.pass_time(1.5, **trouble) == []


def test_short_bursts_of_load_degrade_no_class() -> None:
    day = Day()
    for _ in range(10):
        day.pass_time(6.0)
        assert day.pass_time(0.75, load=1.5) == []


def test_late_windows_degrade_no_class_while_the_machine_is_half_idle() -> None:
    day = Day()
    for _ in range(100):
        day.now += EVERY_S
        day.degradation.note_windows(day.now, 100, 90)
        assert list(day.degradation.update(day.now, 0.4, day.present, busy=0.49)) == []
    assert day.pass_time(2.0, late=0.5) == [BATCH]


def test_heroes_are_degraded_last_and_never_hold() -> None:
    day = Day()
    moved = day.pass_time(200.0, late=0.5)
    assert moved.index(NEAR) < moved.index(HERO)
    assert moved.index(CROWD) < moved.index(NEAR)
    assert [day.degradation.level(priority).hold for priority in Priority] == [False, False, True, True]
    least = [level.tier for level in LEVELS if not level.hold][-1]
    assert [day.degradation.level(priority).tier for priority in (HERO, NEAR)] == [least] * 2


def test_classes_without_sessions_are_skipped() -> None:
    day = Day({NEAR: 3})
    assert day.pass_time(4.0, late=0.5) == [NEAR, NEAR]
    assert day.levels()[NEAR - 1] == 2


def test_levels_recover_after_ten_good_seconds_in_reverse_order() -> None:
    day = Day()
    down = day.pass_time(20.0, late=0.5)
    assert day.pass_time(9.0) == []
    up = day.pass_time(200.0)
    assert up == down[::-1]
    assert day.levels() == [0, 0, 0, 0]


def test_no_level_recovers_while_the_load_is_high() -> None:
    day = Day()
    day.pass_time(4.0, late=0.5)
    assert day.pass_time(100.0, load=0.9) == []


def test_recovery_that_fails_is_retried_ever_less_often() -> None:
    day = Day()
    day.pass_time(2.0, late=0.5)
    ups = []
    for _ in range(int(600 / EVERY_S)):
        # One level down no window is late; as soon as the class has recovered, half of them are.
        moved = day.pass_time(EVERY_S, late=0.0 if day.levels()[BATCH - 1] else 0.5)
        if moved and not day.levels()[BATCH - 1]:
            ups.append(day.now)
    gaps = [later - earlier for earlier, later in itertools.pairwise(ups)]
    assert gaps[:3] == sorted(gaps[:3])
    assert max(gaps) >= 80.0
    assert len(ups) < 15


def test_few_late_windows_do_not_count() -> None:
    degradation = Degradation(LEVELS, 0.0)
    degradation.note_windows(3.0, 5, 5)
    assert list(degradation.update(3.0, 0.1, ALL)) == []
    assert degradation.missed_share == 0.0


def test_old_deadline_misses_are_forgotten() -> None:
    degradation = Degradation(LEVELS, 0.0)
    degradation.note_windows(1.0, 100, 100)
    assert list(degradation.update(1.0 + DegradationLimits().miss_window_s + 0.1, 0.1, ALL)) == []
    assert degradation.missed_share == 0.0


def test_each_level_gives_no_more_than_the_one_before() -> None:
    steps = [level.steps or FACTS.default_steps for level in LEVELS]
    assert steps == sorted(steps, reverse=True)
    assert min(steps) >= FACTS.min_steps
    assert [level.tier for level in LEVELS] == sorted(level.tier for level in LEVELS)
    assert LEVELS[0] is FULL
    assert LEVELS[-1].tier is ServiceTier.HOLD
    holds = [level.hold for level in LEVELS]
    assert holds == sorted(holds)
    shares = [level.held_share for level in LEVELS]
    assert shares == sorted(shares)
    assert (shares[holds.index(True) - 1], shares[-1]) == (0.0, 1.0)


def test_slightly_late_windows_degrade_no_class() -> None:
    day = Day()
    for _ in range(40):
        day.now += EVERY_S
        day.degradation.note_windows(day.now, 20, 3 * 0.05)  # three of twenty, each by a twentieth of its time
        assert day.degradation.update(day.now, 0.7, ALL) == ()


def test_levels_reset_when_no_session_is_left() -> None:
    day = Day()
    day.pass_time(20.0, load=1.5)
    assert max(day.levels()) > 1
    day.present = dict.fromkeys(Priority, 0)
    day.pass_time(EVERY_S)
    assert day.levels() == [0, 0, 0, 0]
    day.present = ALL
    assert day.pass_time(1.0, load=0.97) == [], "overload from before does not count for the sessions present now"


def test_class_without_sessions_does_not_go_down_to_hold_with_the_others() -> None:
    """Its class was skipped while the others were degraded, so no session of it has held a pose before."""
    day = Day({HERO: 3})
    while day.degradation.depth(HERO) < 2:
        day.pass_time(EVERY_S, load=0.97)
    assert not day.degradation.level(CROWD).hold
    day.present = {HERO: 3, CROWD: 1}
    while not (moved := day.pass_time(EVERY_S, load=0.97)):
        pass
    assert moved == [CROWD], "once present, it is degraded before the heroes are degraded further"
    assert day.degradation.level(CROWD).hold
    day.present = {HERO: 3}
    day.pass_time(EVERY_S)
    assert not day.degradation.level(CROWD).hold
    day.pass_time(300.0)
    assert day.levels() == [0, 0, 0, 0]


SAVING = [1.0, 1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.0]
"""The part of its full load that a class takes on each level."""


def test_class_goes_down_at_once_by_as_many_levels_as_its_demand_needs() -> None:
    assert len(SAVING) == len(LEVELS)
    for asked, deep in ((1.1, 2), (1.4, 3), (1.7, 4), (2.1, 5), (4.0, 7)):
        day = Day({CROWD: 10})
        day.pass_time(2.0, load=0.99, demand=Demand({CROWD: asked}, SAVING))
        assert day.levels()[CROWD - 1] == deep
        assert asked * SAVING[deep] <= 0.9 < asked * SAVING[deep - 1]
        assert day.pass_time(1.75, load=0.99, demand=Demand({CROWD: asked}, SAVING)) == [], "this has to show first"


def test_load_from_elsewhere_counts_when_levels_are_chosen() -> None:
    day = Day({CROWD: 10})
    day.pass_time(2.0, load=0.99, demand=Demand({CROWD: 0.6}, SAVING, elsewhere=0.5))
    assert 0.5 + 0.6 * SAVING[day.levels()[CROWD - 1]] <= 0.9


def test_late_windows_cost_one_level_although_the_demand_should_fit() -> None:
    day = Day({CROWD: 10})
    assert day.pass_time(2.25, late=0.05, demand=Demand({CROWD: 0.5}, SAVING)) == []
    assert day.pass_time(0.5, late=0.05, demand=Demand({CROWD: 0.5}, SAVING)) == [CROWD]
    assert day.levels()[CROWD - 1] == 1


@pytest.mark.parametrize(
    ("demand", "moved"),
    [(Demand({CROWD: 0.8}, SAVING), []), (Demand({CROWD: 1.0}, SAVING), [CROWD]), (None, [CROWD])],
    ids=["demand fits", "demand does not fit", "demand unknown"],
)
def test_brief_lateness_degrades_no_class_if_the_demand_fits(demand: Demand | None, moved: list[Priority]) -> None:
    """As under a quota of processor time, where everything stalls now and then."""
    day = Day({CROWD: 10})
    day.pass_time(5.0, demand=demand)
    assert day.pass_time(EVERY_S, late=0.5, demand=demand) == []
    assert day.pass_time(4.0, demand=demand) == moved


def _exhaust_recoveries(day: Day) -> None:
    """Alternate overload and recovery until many recoveries have failed, so that the wait for the next is long."""
    for _ in range(12):
        day.pass_time(8.0, load=1.2)
        day.pass_time(12.0, load=0.5)
    day.pass_time(30.0, load=1.2)


def test_recovery_does_not_wait_long_once_the_demand_fits() -> None:
    day, waits = Day({CROWD: 10}), Day({CROWD: 10})
    for each in (day, waits):
        _exhaust_recoveries(each)
    assert day.levels()[CROWD - 1] == len(LEVELS) - 1
    waits.pass_time(30.0, load=0.2)
    day.pass_time(30.0, load=0.2, demand=Demand({CROWD: 0.5}, SAVING))
    assert waits.levels()[CROWD - 1] > 0
    assert day.levels() == [0, 0, 0, 0]


def test_demand_is_not_trusted_again_after_recoveries_failed() -> None:
    day = Day({CROWD: 10})
    _exhaust_recoveries(day)
    ups = 0
    for _ in range(20):
        ups += len(day.pass_time(5.25, load=0.2, demand=Demand({CROWD: 0.5}, SAVING)))
        day.pass_time(4.0, load=1.2, demand=Demand({CROWD: 0.5}, SAVING))
    assert ups <= 4


def _waits_before_recoveries(day: Day) -> list[float]:
    """The waits before each recovery of a level, in seconds, until every class is at full service."""
    waits, at = [], day.now
    while any(day.levels()):
        if day.pass_time(EVERY_S):
            waits.append(day.now - at)
            at = day.now
    return waits


def test_wait_before_a_recovery_is_halved_if_the_one_before_held() -> None:
    day, exhausted = Day(), Day({CROWD: 10})
    down = day.pass_time(20.0, late=0.5)
    first, *others = _waits_before_recoveries(day)
    assert first >= 10.0
    assert others == [10.0] * (len(down) - 1)
    _exhaust_recoveries(exhausted)
    first, *others = _waits_before_recoveries(exhausted)
    assert 80.0 <= first <= 82.0
    assert others == [40.0, 20.0, *[10.0] * (len(others) - 2)]


def test_demand_is_trusted_again_once_no_session_was_left() -> None:
    day, fits = Day({CROWD: 10}), Demand({CROWD: 0.5}, SAVING)
    _exhaust_recoveries(day)
    for _ in range(4):
        day.pass_time(5.25, load=0.2, demand=fits)
        day.pass_time(4.0, load=1.2, demand=fits)
    assert day.pass_time(5.25, load=0.2, demand=fits) == [], "the recovery did not hold"
    day.present = {}
    day.pass_time(EVERY_S, load=0.0)
    day.present = {CROWD: 10}
    day.pass_time(2.0, load=1.2)
    assert day.levels()[CROWD - 1] > 0
    assert day.pass_time(5.25, load=0.2, demand=fits) == [CROWD]
