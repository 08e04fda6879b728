"""Levels: which sessions of a class hold, and which part of its full load a level keeps."""

import pytest

from motiongen_server.engine.scheduling.levels import FULL, levels_of
from motiongen_server.engine.scheduling.prices import Prices
from tests.server.engine.fakes import FACTS

LEVELS = levels_of(FACTS)
HOLDS = [level for level in LEVELS if level.hold]
LEAST = [level for level in LEVELS if not level.hold][-1]


def test_newest_sessions_of_a_class_hold_and_the_others_get_frames() -> None:
    for level in HOLDS:
        for sessions in (1, 2, 7, 100):
            given = level.of_class(sessions)
            stand = [each.hold for each in given]
            assert len(given) == sessions
            assert stand == sorted(stand)
            assert level.held_share * sessions <= sum(stand) < level.held_share * sessions + 1
            assert {each for each in given if not each.hold} <= {LEAST}


def test_level_without_hold_is_the_same_for_all_sessions() -> None:
    for level in LEVELS:
        if not level.hold:
            assert level.of_class(3) == [level] * 3
            assert level.of_newcomers is level


def test_newcomers_hold_only_on_the_level_on_which_all_hold() -> None:
    assert [level.of_newcomers for level in HOLDS] == [LEAST] * (len(HOLDS) - 1) + [HOLDS[-1]]


@pytest.mark.parametrize("prices", [Prices(0.01, 0.03), Prices(0.01, 0.0), Prices()])
def test_each_level_takes_no_more_than_the_one_before(prices: Prices) -> None:
    kept = [level.kept(FACTS, prices) for level in LEVELS]
    assert kept == sorted(kept, reverse=True)
    assert (FULL.kept(FACTS, prices), kept[-1]) == (1.0, 0.0)


def test_half_the_steps_save_half_the_cost_of_steps_only() -> None:
    level = next(level for level in LEVELS if level.steps == FACTS.default_steps // 2 and not level.drop_guidance)
    steps_s = FACTS.default_steps * 0.01
    assert level.kept(FACTS, Prices(0.01, 0.04)) == pytest.approx((steps_s / 2 + 0.04) / (steps_s + 0.04))
