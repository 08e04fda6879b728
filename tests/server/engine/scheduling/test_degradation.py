import itertools
from collections.abc import Mapping

import pytest

from motiongen_server.engine.scheduling.degradation import Degradation, DegradationLimits, Demand
from motiongen_server.engine.scheduling.levels import FULL, levels_of
from motiongen_server.engine.types import Priority, ServiceTier
from tests.server.engine.fakes import FACTS

HERO, NEAR, CROWD, BATCH = Priority
RUNGS = levels_of(FACTS)
EVERY_S = 0.25
ALL = dict.fromkeys(Priority, 10)


class Day:
    """Degradation that is asked four times a second, under a load and with a share of windows late."""

    def __init__(self, present: Mapping[Priority, int] | None = None) -> None:
        self.now = 0.0
        self.present = ALL if present is None else present
        self.degradation = Degradation(RUNGS, self.now)
        self.moved: list[Priority] = []
        self.shed = 0

    def pass_time(
        self, seconds: float, load: float = 0.3, late: float = 0.0, demand: Demand | None = None
    ) -> list[Priority]:
        """Returns the classes that moved meanwhile, in order."""
        moved: list[Priority] = []
        for _ in range(round(seconds / EVERY_S)):
            self.now += EVERY_S
            self.degradation.note_windows(self.now, 100, round(100 * late))
            moved += self.degradation.update(self.now, load, self.present, demand=demand)
            self.shed += self.degradation.shed
        return moved

    def levels(self) -> list[int]:
        return [self.degradation.depth(priority) for priority in Priority]


def test_a_machine_that_keeps_up_gives_everybody_everything() -> None:
    day = Day()
    assert day.pass_time(60.0, load=0.9, late=0.01) == []
    assert all(day.degradation.level(priority) is FULL for priority in Priority)


@pytest.mark.parametrize("trouble", [{"load": 0.97}, {"late": 0.05}])
def test_under_pressure_the_least_urgent_class_goes_down_a_rung_every_two_seconds(trouble: dict[str, float]) -> None:
    day = Day()
    assert day.pass_time(2.0, **trouble) == [BATCH]
    assert day.pass_time(2.0, **trouble) == [CROWD]
    assert (day.levels(), day.shed) == ([0, 0, 1, 1], 0)
    assert day.pass_time(1.5, **trouble) == []


def test_a_burst_that_is_over_soon_costs_nobody_anything() -> None:
    day = Day()
    for _ in range(10):
        day.pass_time(6.0)
        assert day.pass_time(0.75, load=1.5) == []


def test_nobody_gets_less_while_the_machine_stands_idle_half_the_time() -> None:
    day = Day()
    for _ in range(100):
        day.now += EVERY_S
        day.degradation.note_windows(day.now, 100, 90)
        assert list(day.degradation.update(day.now, 0.4, day.present, busy=0.49)) == []
    assert day.pass_time(2.0, late=0.5) == [BATCH]


def test_heroes_give_up_last_and_are_never_held() -> None:
    day = Day()
    moved = day.pass_time(200.0, late=0.5)
    assert moved.index(NEAR) < moved.index(HERO)
    assert moved.index(CROWD) < moved.index(NEAR)
    assert [day.degradation.level(priority).hold for priority in Priority] == [False, False, True, True]
    least = [level.tier for level in RUNGS if not level.hold][-1]
    assert [day.degradation.level(priority).tier for priority in (HERO, NEAR)] == [least] * 2


def test_classes_without_sessions_are_passed_over() -> None:
    day = Day({NEAR: 3})
    assert day.pass_time(4.0, late=0.5) == [NEAR, NEAR]
    assert day.levels()[NEAR - 1] == 2


def test_it_goes_up_a_rung_after_ten_good_seconds_the_most_urgent_first() -> None:
    day = Day()
    down = day.pass_time(20.0, late=0.5)
    assert day.pass_time(9.0) == []
    up = day.pass_time(200.0)
    assert up == down[::-1]
    assert day.levels() == [0, 0, 0, 0]


def test_it_does_not_go_up_while_the_load_is_high() -> None:
    day = Day()
    day.pass_time(4.0, late=0.5)
    assert day.pass_time(100.0, load=0.9) == []


def test_a_rung_that_does_not_hold_is_tried_ever_less_often() -> None:
    day = Day()
    day.pass_time(2.0, late=0.5)
    ups = []
    for _ in range(int(600 / EVERY_S)):
        # One level down it goes well; as soon as the class is up again, it does not.
        moved = day.pass_time(EVERY_S, late=0.0 if day.levels()[BATCH - 1] else 0.5)
        if moved and not day.levels()[BATCH - 1]:
            ups.append(day.now)
    gaps = [later - earlier for earlier, later in itertools.pairwise(ups)]
    assert gaps[:3] == sorted(gaps[:3])
    assert max(gaps) >= 80.0
    assert len(ups) < 15


def test_a_few_windows_say_nothing() -> None:
    degradation = Degradation(RUNGS, 0.0)
    degradation.note_windows(3.0, 5, 5)
    assert list(degradation.update(3.0, 0.1, ALL)) == []
    assert degradation.missed_share == 0.0


def test_old_misses_are_forgotten() -> None:
    degradation = Degradation(RUNGS, 0.0)
    degradation.note_windows(1.0, 100, 100)
    assert list(degradation.update(1.0 + DegradationLimits().miss_window_s + 0.1, 0.1, ALL)) == []
    assert degradation.missed_share == 0.0


def test_sessions_are_shed_only_where_the_last_rung_did_not_help_and_only_expendable_ones() -> None:
    day = Day({HERO: 2, CROWD: 5})
    day.pass_time(40.0, late=0.5)
    assert day.shed > 0
    heroes = Day({HERO: 2, NEAR: 5})
    heroes.pass_time(60.0, late=0.5)
    assert heroes.shed == 0


def test_rungs_give_less_and_less() -> None:
    steps = [level.steps or FACTS.default_steps for level in RUNGS]
    assert steps == sorted(steps, reverse=True)
    assert min(steps) >= FACTS.min_steps
    assert [level.tier for level in RUNGS] == sorted(level.tier for level in RUNGS)
    assert RUNGS[0] is FULL
    assert RUNGS[-1].tier is ServiceTier.HOLD
    holds = [level.hold for level in RUNGS]
    assert holds == sorted(holds)
    shares = [level.held_share for level in RUNGS]
    assert shares == sorted(shares)
    assert (shares[holds.index(True) - 1], shares[-1]) == (0.0, 1.0)


def test_windows_that_are_a_moment_late_cost_nobody_anything() -> None:
    day = Day()
    for _ in range(40):
        day.now += EVERY_S
        day.degradation.note_windows(day.now, 20, 3 * 0.05)  # three of twenty, by a twentieth of their time each
        assert day.degradation.update(day.now, 0.7, ALL) == ()


def test_when_nobody_is_left_those_who_come_next_are_served_in_full() -> None:
    day = Day()
    day.pass_time(20.0, load=1.5)
    assert max(day.levels()) > 1
    day.present = dict.fromkeys(Priority, 0)
    day.pass_time(EVERY_S)
    assert day.levels() == [0, 0, 0, 0]
    day.present = ALL
    assert day.pass_time(1.0, load=0.97) == [], "what pressed before says nothing of who is there now"


def test_who_comes_while_others_get_less_is_made_frames_all_the_same() -> None:
    """Its class was passed over on the way to what the others have, and nobody of it has ever held a pose for it."""
    day = Day({HERO: 3})
    while day.degradation.depth(HERO) < 2:
        day.pass_time(EVERY_S, load=0.97)
    assert not day.degradation.level(CROWD).hold
    day.present = {HERO: 3, CROWD: 1}
    while not (moved := day.pass_time(EVERY_S, load=0.97)):
        pass
    assert moved == [CROWD], "once it is there, its turn comes before the heroes' next"
    assert day.degradation.level(CROWD).hold
    day.present = {HERO: 3}
    day.pass_time(EVERY_S)
    assert not day.degradation.level(CROWD).hold
    day.pass_time(300.0)
    assert day.levels() == [0, 0, 0, 0]


SAVING = [1.0, 1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.0]
"""Of what a class takes in full, what it takes on each level."""


def test_as_much_is_given_up_at_once_as_has_to_be_and_no_more() -> None:
    assert len(SAVING) == len(RUNGS)
    for asked, deep in ((1.1, 2), (1.4, 3), (1.7, 4), (2.1, 5), (4.0, 7)):
        day = Day({CROWD: 10})
        day.pass_time(2.0, load=0.99, demand=Demand({CROWD: asked}, SAVING))
        assert day.levels()[CROWD - 1] == deep
        assert asked * SAVING[deep] <= 0.9 < asked * SAVING[deep - 1]
        assert day.pass_time(1.75, load=0.99, demand=Demand({CROWD: asked}, SAVING)) == [], "it has to show first"


def test_what_others_take_of_the_machine_counts_too() -> None:
    day = Day({CROWD: 10})
    day.pass_time(2.0, load=0.99, demand=Demand({CROWD: 0.6}, SAVING, elsewhere=0.5))
    assert 0.5 + 0.6 * SAVING[day.levels()[CROWD - 1]] <= 0.9


def test_where_what_is_there_should_fit_already_one_level_is_tried() -> None:
    day = Day({CROWD: 10})
    assert day.pass_time(2.25, late=0.05, demand=Demand({CROWD: 0.5}, SAVING)) == []
    assert day.pass_time(0.5, late=0.05, demand=Demand({CROWD: 0.5}, SAVING)) == [CROWD]
    assert day.levels()[CROWD - 1] == 1


@pytest.mark.parametrize(
    ("demand", "moved"),
    [(Demand({CROWD: 0.8}, SAVING), []), (Demand({CROWD: 1.0}, SAVING), [CROWD]), (None, [CROWD])],
    ids=["what is there fits", "it does not", "nobody knows"],
)
def test_a_moment_of_lateness_costs_nobody_anything_where_what_is_there_fits(
    demand: Demand | None, moved: list[Priority]
) -> None:
    """As under a quota of processor time, where everything stands still now and then."""
    day = Day({CROWD: 10})
    day.pass_time(5.0, demand=demand)
    assert day.pass_time(EVERY_S, late=0.5, demand=demand) == []
    assert day.pass_time(4.0, demand=demand) == moved


def _out_of_patience(day: Day) -> None:
    """Under a load that only lower levels bear: none that it went up to has held, and it waits for long."""
    for _ in range(12):
        day.pass_time(8.0, load=1.2)
        day.pass_time(12.0, load=0.5)
    day.pass_time(30.0, load=1.2)


def test_a_load_that_has_gone_is_forgotten_where_all_that_is_there_fits() -> None:
    day, waits = Day({CROWD: 10}), Day({CROWD: 10})
    for each in (day, waits):
        _out_of_patience(each)
    assert day.levels()[CROWD - 1] == len(RUNGS) - 1
    waits.pass_time(30.0, load=0.2)
    day.pass_time(30.0, load=0.2, demand=Demand({CROWD: 0.5}, SAVING))
    assert waits.levels()[CROWD - 1] > 0
    assert day.levels() == [0, 0, 0, 0]


def test_what_is_asked_is_not_believed_again_once_it_has_not_held() -> None:
    day = Day({CROWD: 10})
    _out_of_patience(day)
    ups = 0
    for _ in range(20):
        ups += len(day.pass_time(5.25, load=0.2, demand=Demand({CROWD: 0.5}, SAVING)))
        day.pass_time(4.0, load=1.2, demand=Demand({CROWD: 0.5}, SAVING))
    assert ups <= 4


def _seconds_between_ups(day: Day) -> list[float]:
    """How long each level up is waited for, until everybody has everything."""
    waits, at = [], day.now
    while any(day.levels()):
        if day.pass_time(EVERY_S):
            waits.append(day.now - at)
            at = day.now
    return waits


def test_each_level_up_is_waited_for_anew_and_half_as_long_where_the_one_before_held() -> None:
    day, out_of_patience = Day(), Day({CROWD: 10})
    down = day.pass_time(20.0, late=0.5)
    first, *others = _seconds_between_ups(day)
    assert first >= 10.0
    assert others == [10.0] * (len(down) - 1)
    _out_of_patience(out_of_patience)
    first, *others = _seconds_between_ups(out_of_patience)
    assert 80.0 <= first <= 82.0
    assert others == [40.0, 20.0, *[10.0] * (len(others) - 2)]


def test_once_nobody_is_left_what_is_asked_is_believed_again() -> None:
    day, fits = Day({CROWD: 10}), Demand({CROWD: 0.5}, SAVING)
    _out_of_patience(day)
    for _ in range(4):
        day.pass_time(5.25, load=0.2, demand=fits)
        day.pass_time(4.0, load=1.2, demand=fits)
    assert day.pass_time(5.25, load=0.2, demand=fits) == [], "it did not hold"
    day.present = {}
    day.pass_time(EVERY_S, load=0.0)
    day.present = {CROWD: 10}
    day.pass_time(2.0, load=1.2)
    assert day.levels()[CROWD - 1] > 0
    assert day.pass_time(5.25, load=0.2, demand=fits) == [CROWD]
