"""When sessions are closed because nothing else is left to give up."""

import pytest

from motiongen_server.engine.types import Priority
from tests.server.engine.scheduling.degrading import EVERY_S, LEVELS, Day

HERO, NEAR, CROWD, _ = Priority


def test_crowd_sessions_are_shed_once_no_level_is_left_and_then_every_2_s_while_overload_lasts() -> None:
    day = Day({HERO: 2, CROWD: 5})
    num_moves = num_moved = 0
    while not day.shed:
        before = day.degradation.depth(HERO), day.degradation.depth(CROWD)
        num_moved = len(day.pass_time(EVERY_S, late=0.5))
        num_moves += num_moved
        assert day.now < 60.0
    last, last_unheld = len(LEVELS) - 1, sum(not level.hold for level in LEVELS) - 1
    assert before == (last_unheld, last), "all that is left to give up"
    assert (num_moves, num_moved) == (last_unheld + last, 0), "a level given up has to show what it saves first"
    day.pass_time(10.0, late=0.5)
    assert day.shed == 6
    day.pass_time(10.0)
    assert day.shed == 6


@pytest.mark.parametrize("present", [{HERO: 2, NEAR: 5}, {HERO: 2}])
def test_no_session_is_shed_where_only_heroes_and_near_ones_are_left(present: dict[Priority, int]) -> None:
    day = Day(present)
    day.pass_time(60.0, late=0.5)
    assert day.levels()[HERO - 1] == sum(not level.hold for level in LEVELS) - 1
    assert day.shed == 0
