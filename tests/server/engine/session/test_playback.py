import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.session.playback import PlaybackClock, RoundTrip
from motiongen_server.engine.types import PlayState


def test_playhead_stays_at_0_until_its_first_report() -> None:
    clock = PlaybackClock(20)
    assert clock.estimate(1000.0, 40) == 0
    assert clock.reaches_at(10) == math.inf
    clock.report(0, 1000.0, 40)
    assert clock.estimate(1000.5, 40) == 10
    assert clock.reaches_at(10) == 1000.5


def test_playhead_estimate_stops_at_the_end_of_what_was_sent() -> None:
    clock = PlaybackClock(20)
    clock.report(30, 0.0, 40)
    assert clock.estimate(0.25, 40) == 35
    assert clock.estimate(9.0, 40) == 40
    assert clock.unheld(9.0) == 210


def test_playback_after_an_underrun_continues_from_where_it_waited() -> None:
    clock = PlaybackClock(20)
    clock.report(30, 0.0, 40)
    clock.resume_from(40, 9.0)
    assert clock.estimate(9.5, 80) == 50


def test_report_beyond_what_was_sent_is_capped_and_a_lower_one_ignored() -> None:
    clock = PlaybackClock(20)
    clock.report(2**63, 0.0, 40)
    assert clock.reported == 40
    clock.report(12, 0.5, 60)
    assert clock.reported == 40
    assert clock.estimate(0.5, 60) == 50


def test_pause_stops_the_playhead_where_it_is() -> None:
    clock = PlaybackClock(20)
    clock.report(0, 0.0, 40)
    clock.set_state(PlayState.PAUSED, 0.5, 40)
    assert clock.estimate(7.0, 40) == 10
    assert clock.reaches_at(11) == math.inf
    clock.set_state(PlayState.PLAYING, 8.0, 40)
    assert clock.estimate(8.5, 40) == 20


# ---- the round trip --------------------------------------------------------------------------------------------------


def test_round_trip_is_the_assumed_one_until_it_is_measured() -> None:
    trip = RoundTrip(0.05)
    trip.report(None, 1.0)
    trip.report(math.nan, 1.0)
    assert trip.seconds == 0.05
    trip.report(0.01, 1.0)
    assert trip.seconds == 0.01


def test_a_long_round_trip_counts_at_once_and_is_slowly_forgotten() -> None:
    trip = RoundTrip(0.05)
    trip.report(0.02, 0.0)
    trip.report(0.4, 1.0)
    assert trip.seconds == 0.4
    trip.report(0.02, 11.0)
    assert trip.seconds == pytest.approx(0.2)
    trip.report(0.02, 11.0)
    assert trip.seconds == pytest.approx(0.2)
    for second in range(12, 80):
        trip.report(0.02, float(second))
    assert trip.seconds == 0.02


@given(st.lists(st.tuples(st.none() | st.floats(), st.floats(0, 1e6)), max_size=20))
def test_round_trip_stays_between_0_and_1_s_whatever_is_reported(measured: list[tuple[float | None, float]]) -> None:
    trip = RoundTrip(0.05)
    for seconds, at in measured:
        trip.report(seconds, at)
        assert 0.0 <= trip.seconds <= 1.0


# ---- false playheads -------------------------------------------------------------------------------------------------

SLACK = 40


def credit_of(seconds: int, frame_of: Callable[[int, int], int], rate: float = 1.05) -> PlaybackClock:
    """A clock that gets a report four times a second from a client that is sent all that it has credit for.

    frame_of: the frame reported, given the quarter of a second and the end of what was sent.
    """
    clock, sent_to = PlaybackClock(20, rate=rate, slack=SLACK), SLACK
    for quarter in range(4 * seconds):
        clock.report(frame_of(quarter, sent_to), quarter / 4, sent_to)
        sent_to = clock.credited + SLACK
    return clock


@pytest.mark.parametrize(
    "frame_of",
    [
        lambda quarter, sent_to: sent_to,
        lambda quarter, sent_to: sent_to - 1,
        lambda quarter, sent_to: 2**53,
        lambda quarter, sent_to: sent_to if quarter % 2 else 0,
        lambda quarter, sent_to: 20 * quarter,
    ],
    ids=["the end", "the last frame", "a frame that does not exist", "back and forth", "four times as fast"],
)
def test_credit_for_false_playheads_is_real_time_and_one_look_ahead(frame_of: Callable[[int, int], int]) -> None:
    clock = credit_of(60, frame_of)
    assert 60 * 20 - 10 <= clock.credited <= 60 * 20 * 1.05 + SLACK
    assert clock.paced(60.0, 10**6) <= 60 * 20 * 1.06 + 10, "deadlines count from the position without jumps"


def test_honest_client_gets_its_full_credit_and_pace() -> None:
    clock = credit_of(60, lambda quarter, sent_to: 5 * quarter)
    assert clock.credited == clock.reported == 5 * (4 * 60 - 1)
    assert clock.paced(59.75, 10**6) == pytest.approx(clock.estimate(59.75, 10**6))


def test_client_allowed_to_play_faster_gets_credit_for_it() -> None:
    assert credit_of(10, lambda quarter, sent_to: 10 * quarter, rate=2.0).credited == 390


@pytest.mark.parametrize("paused_s", [0.0, 2.0, 30.0])
@pytest.mark.parametrize("jumps", ["during the pause", "after the pause"])
def test_jump_during_or_after_a_pause_does_not_advance_the_pace(paused_s: float, jumps: str) -> None:
    clock = PlaybackClock(20, slack=SLACK)
    for quarter in range(5):
        clock.report(5 * quarter, quarter / 4, 60)
    clock.set_state(PlayState.PAUSED, 1.0, 60)
    if jumps == "during the pause":
        clock.report(60, 1.0 + paused_s, 60)
    clock.set_state(PlayState.PLAYING, 1.0 + paused_s, 60)
    clock.report(60, 1.1 + paused_s, 60)
    assert clock.estimate(1.1 + paused_s, 60) == 60
    assert clock.paced(1.1 + paused_s, 60) == pytest.approx(20 + 0.1 * 20 * 1.05), "where it is without a jump"


def test_client_that_pauses_gets_its_full_credit_and_pace() -> None:
    clock, sent_to = PlaybackClock(20, slack=SLACK), SLACK
    clock.report(0, 0.0, sent_to)
    for quarter in range(1, 240):
        at = quarter / 4
        for state in (PlayState.PAUSED, PlayState.PLAYING):
            clock.set_state(state, at - 0.01, sent_to)
        clock.report(5 * quarter, at, sent_to)
        assert clock.credited == clock.reported == 5 * quarter
        assert clock.paced(at + 0.2, 10**6) == pytest.approx(clock.estimate(at + 0.2, 10**6))
        sent_to = clock.credited + SLACK
