"""What a client that missed plans has to drop, compared with a client that keeps its own record of every plan."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_server.engine.session.plan_log import PlanLog
from motiongen_server.engine.types import PlanCause, PlanNotice, SessionKey

KEY = SessionKey(1, 1)


def notice(plan: int, valid_from: int, *event_seqs: int) -> PlanNotice:
    return PlanNotice(KEY, plan, valid_from, PlanCause.EDIT, event_seqs)


def test_client_that_missed_no_plan_keeps_all_its_frames() -> None:
    log = PlanLog()
    log.note(notice(1, 0), 0)
    assert log.missed(1, 30) == (30, ())


def test_missed_plans_count_from_the_first_frame_that_any_of_them_replaces() -> None:
    log = PlanLog()
    log.note(notice(1, 0), 0)
    log.note(notice(2, 20, 5), 40)
    log.note(notice(3, 30, 6), 40)
    assert log.missed(1, 40) == (20, (5, 6))
    assert log.missed(2, 40) == (30, (6,))


def test_events_of_a_plan_that_is_wholly_replaced_pass_to_the_next() -> None:
    log = PlanLog()
    log.note(notice(1, 0), 0)
    log.note(notice(2, 30, 5), 40)
    log.note(notice(3, 20, 6), 30)
    assert len(log) == 2
    assert log.missed(1, 40) == (20, (5, 6))
    assert log.missed(2, 30) == (20, (5, 6))


def test_plan_is_dropped_once_a_frame_sent_after_it_is_shown() -> None:
    log = PlanLog()
    log.note(notice(1, 0), 0)
    log.note(notice(2, 20), 40)
    log.confirm(40)
    assert log.missed(1, 40) == (20, ()), "frame 40 was not sent before the plan, but 39 was"
    log.confirm(41)
    assert len(log) == 0


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 30), st.integers(0, 40), st.integers(0, 40), st.booleans()), min_size=1, max_size=40
    )
)
def test_client_cut_off_at_any_plan_drops_exactly_the_replaced_frames(moves: list[tuple[int, int, int, bool]]) -> None:
    log = PlanLog()
    sent_to = playhead = 0
    heard, held_to, void_from = 0, 0, None
    is_there = True
    for plan, (back, ahead, played, goes_away) in enumerate(moves, 1):
        valid_from = max(playhead + 1 if sent_to else 0, sent_to - back)
        log.note(notice(plan, valid_from), sent_to)
        sent_to = max(valid_from, min(playhead + 40, valid_from + ahead))
        if is_there:
            heard, held_to = plan, sent_to
            playhead = min(playhead + played, max(sent_to - 1, 0))
            log.confirm(playhead)
            is_there = not goes_away
        else:
            void_from = valid_from if void_from is None else min(void_from, valid_from)
        assert len(log) <= 100
    first_void, _ = log.missed(heard, held_to)
    assert min(first_void, held_to) == (held_to if void_from is None else min(void_from, held_to))
