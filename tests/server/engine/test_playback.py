import math

from server.engine.playback import PlaybackClock
from server.engine.types import PlayState


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
