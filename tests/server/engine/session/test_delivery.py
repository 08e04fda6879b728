import math

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.delivery import Delivery
from motiongen_server.engine.session.playback import PlaybackClock, RoundTrip
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import PlanCause, PlanNotice, Playhead, Resume, Resumed, SessionKey

KEY = SessionKey(1, 1)


def playing_at(frame: int, at: float) -> Delivery:
    delivery = Delivery(KEY, 40, EngineConfig(), PlaybackClock(20), RoundTrip(0.05), sent_to=80)
    delivery.report(Playhead(KEY, 0, at, frame, 80, 0))
    return delivery


@pytest.mark.parametrize("lead_s", [0.0, 0.05, 0.07, 0.17, 0.2, 0.233])
def test_unshown_from_is_after_any_frame_that_may_be_shown_by_then(lead_s: float) -> None:
    # a client that reports frame 10 is anywhere from its beginning up to, not including, frame 11
    shown_at_last = math.floor(10.999 + 20 * lead_s)
    assert playing_at(10, 100.0).unshown_from(100.0, lead_s) == shown_at_last + 1


def test_unshown_from_advances_while_no_playhead_is_reported() -> None:
    delivery = playing_at(10, 100.0)
    assert [delivery.unshown_from(100.0 + wait_s, 0.1) for wait_s in (0.01, 0.05, 1.0)] == [14, 14, 33]
    assert delivery.unshown_from(200.0, 0.1) == 83, "playback waits at the end of what was sent"


def test_frames_already_shown_stay_valid_on_resuming_although_a_missed_plan_replaced_them() -> None:
    delivery = playing_at(10, 100.0)
    delivery.plan_log.note(PlanNotice(KEY, 2, 30, PlanCause.EDIT, (7,)), 80)
    delivery.report(Playhead(KEY, 0, 101.75, 45, 80, 0))  # it plays on what it has
    (resumed,) = delivery.resume(Resume(KEY, 0, 102.0, attempt=3, plan=1, next_frame=80), 2, 0)
    assert resumed == Resumed(KEY, 3, 45, PlanNotice(KEY, 2, 45, PlanCause.RESUME, (7,)))
    assert delivery.sent_to == 45


TIMELINE = Timeline.empty(2, 1).spliced(0, np.zeros((80, 2), np.float32), np.zeros((80, 1), np.float32))


@pytest.mark.parametrize(("now", "late"), [(100.0, 0), (100.5, 0), (100.51, 1), (100.69, 4), (102.0, 30), (200.0, 30)])
def test_frames_that_were_due_before_they_were_sent_count_as_late_once(now: float, late: int) -> None:
    delivery = Delivery(KEY, 40, EngineConfig(), PlaybackClock(20), RoundTrip(0.05), sent_to=20)
    delivery.report(Playhead(KEY, 0, 100.0, 10, 20, 0))  # which has frame 20 due half a second later
    chunks = delivery.chunks(now, TIMELINE, 1, math.inf)
    assert chunks[0].first_frame == 20
    assert sum(len(chunk.rows) for chunk in chunks) == 30, "as far as the look-ahead of 40 goes"
    assert (delivery.late_frames, delivery.num_frames, delivery.sent_to) == (late, 50, 50)
    assert delivery.chunks(now, TIMELINE, 1, math.inf) == []
    assert delivery.superseded(45) == 5
    delivery.chunks(100.0, TIMELINE, 2, math.inf)
    assert (delivery.late_frames, delivery.num_frames, delivery.sent_to) == (late, 50, 50), "they were sent before"


@pytest.mark.parametrize(("rtt_s", "far_frames"), [(0.0, 0), (0.05, 0), (0.06, 1), (0.25, 4), (9.0, 19)])
def test_round_trip_beyond_the_assumed_one_is_counted_in_far_frames(rtt_s: float, far_frames: int) -> None:
    config = EngineConfig(rtt_s=0.05)
    delivery = Delivery(KEY, 40, config, PlaybackClock(20), RoundTrip(config.rtt_s), sent_to=20)
    assert delivery.far_frames == 0
    delivery.report(Playhead(KEY, 0, 100.0, 10, 20, 0, rtt_s))
    assert delivery.far_frames == far_frames


def test_commit_lead_and_times_of_frames_count_from_the_playhead() -> None:
    delivery = playing_at(10, 100.0)
    assert delivery.commit_s == pytest.approx(0.05 + delivery.config.flush_s + delivery.config.margin_s)
    assert delivery.commit_frames == math.ceil(20 * delivery.commit_s) + 1
    assert delivery.reaches_at(30) == pytest.approx(101.0)
    assert delivery.reaches_at(81) == math.inf, "playback waits for more at the end of what was sent"


def test_frames_wait_for_more_except_at_the_end_of_a_plan_or_when_few_are_left() -> None:
    delivery = Delivery(KEY, 40, EngineConfig(), PlaybackClock(20), RoundTrip(0.05), sent_to=40, first_chunk_due=False)
    delivery.report(Playhead(KEY, 0, 100.0, 10, 40, 0))
    assert delivery.waits(100.0, 80), "ten frames are allowed, and thirty more are planned after them"
    assert not delivery.waits(100.0, 45), "all that is left of the plan is allowed"
    assert not delivery.waits(101.2, 80), "the client runs low"


def test_credit_granted_to_a_clip_never_falls_nor_exceeds_what_was_sent() -> None:
    delivery = Delivery(KEY, 40, EngineConfig(), PlaybackClock(20), RoundTrip(0.05), sent_to=30)
    for frame, credited in ((20, 20), (10, 20), (1000, 30)):
        delivery.grant(frame)
        assert delivery.clock.credited == credited
