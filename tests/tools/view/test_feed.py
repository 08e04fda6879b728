"""A feed says from which frame on a browser lacks frames."""

from __future__ import annotations

from motiongen_client import Playback
from motiongen_tools.view.feed import Feed
from tests.client.synthetic import ROW_WIDTH, synthetic_rows


def playback_with(num_frames: int) -> Playback:
    playback = Playback(20, ROW_WIDTH)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, synthetic_rows(1, 0, num_frames), 5)
    return playback


def test_new_frames_are_reported_once() -> None:
    playback = playback_with(0)
    feed = Feed(playback)
    assert feed.changed_from() is None
    playback.add_chunk(1, 0, synthetic_rows(1, 0, 8), 5)
    assert feed.changed_from() == 0
    assert feed.changed_from() is None
    playback.add_chunk(1, 8, synthetic_rows(1, 8, 8), 5)
    assert feed.changed_from() == 8


def test_a_replan_is_reported_from_its_first_frame() -> None:
    playback = playback_with(30)
    feed = Feed(playback)
    feed.changed_from()
    playback.advance(0.0)
    playback.announce_plan(2, 12)
    playback.add_chunk(2, 12, synthetic_rows(2, 12, 18), 12)
    assert feed.changed_from() == 12


def test_dropped_frames_are_reported_too() -> None:
    playback = playback_with(30)
    feed = Feed(playback)
    feed.changed_from()
    playback.announce_plan(2, 12)
    assert feed.changed_from() == 12
    playback.add_chunk(2, 12, synthetic_rows(2, 12, 8), 12)
    assert feed.changed_from() == 12
