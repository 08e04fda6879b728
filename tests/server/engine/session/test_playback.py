import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.session.playback import PlaybackClock, RoundTrip
from motiongen_server.engine.types import PlayState


def test_the_playhead_stands_at_0_until_its_first_report() -> None:
    clock = PlaybackClock(20)
    assert clock.estimate(1000.0, 40) == 0
    assert clock.reaches_at(10) == math.inf
    clock.report(0, 1000.0, 40)
    assert clock.estimate(1000.5, 40) == 10
    assert clock.reaches_at(10) == 1000.5


def test_the_playhead_runs_no_further_than_what_was_sent() -> None:
    clock = PlaybackClock(20)
    clock.report(30, 0.0, 40)
    assert clock.estimate(0.25, 40) == 35
    assert clock.estimate(9.0, 40) == 40
    assert clock.unheld(9.0) == 210


def test_after_an_underrun_playback_goes_on_from_where_it_waited() -> None:
    clock = PlaybackClock(20)
    clock.report(30, 0.0, 40)
    clock.resume_from(40, 9.0)
    assert clock.estimate(9.5, 80) == 50


def test_a_report_of_a_frame_never_sent_counts_as_what_was_sent_and_a_lower_one_not_at_all() -> None:
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


def test_the_round_trip_is_what_was_assumed_until_it_is_measured() -> None:
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
def test_no_measurement_makes_a_round_trip_absurd(measured: list[tuple[float | None, float]]) -> None:
    trip = RoundTrip(0.05)
    for seconds, at in measured:
        trip.report(seconds, at)
        assert 0.0 <= trip.seconds <= 1.0
