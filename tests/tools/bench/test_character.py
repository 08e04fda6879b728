"""Playback by arithmetic: which frames are missed, and between which moments an edit is measured."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_tools.bench.character import START_GRACE_S, Character
from motiongen_tools.bench.recorder import ANSWER, EVENT, LATENESS, OPEN, SCREEN, SLACK, Recorder
from motiongen_tools.bench.schedule import CharacterPlan, Phases

FPS = 20
PHASES = Phases(ramp_s=1.0, measure_from_s=2, measure_to_s=12, end_s=15.0)
NO_JITTER = tuple([0.0] * 1021)


class Table:
    """A character whose session opened at 0 s, and what its server sends."""

    def __init__(self, close_s: float = math.inf) -> None:
        self.recorder = Recorder(("crowd",), 15)
        self.character = Character(
            1,
            CharacterPlan(0, 0, 0.0, close_s, 5, 0),
            "crowd",
            fps=FPS,
            jitter=NO_JITTER,
            phases=PHASES,
            recorder=self.recorder,
        )
        self.character.open_sent = True
        self.plan = 0

    def send_plan(self, valid_from: int, now_s: float, seqs: Sequence[int] = ()) -> None:
        self.plan += 1
        cause = session_pb2.PLAN_CAUSE_EDIT if seqs else session_pb2.PLAN_CAUSE_CONTINUE
        notice = session_pb2.PlanNotice(plan=self.plan, valid_from=valid_from, cause=cause, event_seqs=seqs)
        self.character.take_notice(notice, now_s)

    def send_frames(self, first: int, count: int, now_s: float) -> None:
        chunk = motion_pb2.FrameChunk(plan=self.plan, first_frame=first, frame_count=count, committed_to=first)
        self.character.take_chunk(chunk, now_s)

    def total(self, what: str) -> float:
        return self.recorder.total(what, 0, 15)


@pytest.fixture
def table() -> Table:
    return Table()


def test_frames_that_arrive_in_time_are_not_missed(table: Table) -> None:
    table.send_plan(0, 0.1)
    for number in range(10):
        table.send_frames(20 * number, 20, 0.1 + 0.9 * number)  # a second of frames, a tenth of a second early
    table.character.end(9.0, as_planned=True)
    assert table.total("missed") == table.total("underruns") == 0
    assert table.total("due") == pytest.approx(8.9 * FPS)
    assert table.recorder.histogram(OPEN).get_max_value() == pytest.approx(100_000, rel=0.01)


def test_each_frame_time_without_a_frame_is_missed_and_playback_continues(table: Table) -> None:
    table.send_plan(0, 0.0)
    table.send_frames(0, 20, 0.0)
    table.send_frames(20, 20, 1.26)  # frame 20 was due at 1.0: held at 1.00, 1.05, .., 1.25
    assert table.total("missed") == 6
    assert table.total("underruns") == 1
    assert table.character.missed == 6
    table.send_frames(40, 20, 2.29)  # due at 1.3 + 20 frames = 2.3
    assert table.total("missed") == 6
    assert table.character.playhead(2.31) == 40


@pytest.mark.parametrize(("arrived_s", "slack_ms", "lateness_ms"), [(2.7, 300, 0), (3.2, 0, 200)])
def test_a_chunk_is_measured_against_the_moment_at_which_it_is_due(
    arrived_s: float, slack_ms: float, lateness_ms: float, table: Table
) -> None:
    table.send_plan(0, 1.0)
    table.send_frames(0, 40, 1.0)
    table.send_frames(40, 20, arrived_s)  # due at 3 s
    for what, milliseconds in ((SLACK, slack_ms), (LATENESS, lateness_ms)):
        histogram = table.recorder.histogram(what)
        assert histogram.get_total_count() == 1
        assert histogram.get_max_value() / 1000 == pytest.approx(milliseconds, abs=1)


def test_a_character_that_never_starts_misses_all_frames_after_a_grace(table: Table) -> None:
    table.character.end(11.0, as_planned=True)
    assert table.total("missed") == pytest.approx((11.0 - START_GRACE_S) * FPS, abs=1)
    assert table.total("due") == pytest.approx((11.0 - START_GRACE_S) * FPS)
    assert table.recorder.counts["characters_without_a_frame"] == 1


def test_a_lost_character_misses_the_frames_it_would_have_played() -> None:
    table = Table(close_s=10.0)
    table.send_plan(0, 0.0)
    table.send_frames(0, 40, 0.0)
    table.character.end(1.0, as_planned=False)
    assert table.total("missed") == pytest.approx(8 * FPS, abs=1)  # frames to 2.0 s had come
    assert table.total("due") == pytest.approx(10 * FPS)


def test_a_character_lost_before_its_first_frame_counts_as_waiting() -> None:
    table = Table(close_s=10.0)
    table.character.end(0.25, as_planned=False)
    assert table.recorder.histogram(OPEN).get_max_value() / 1e6 == pytest.approx(10, rel=0.01)
    assert table.total("due") == pytest.approx((10 - START_GRACE_S) * FPS)
    assert table.total("missed") == pytest.approx((10 - START_GRACE_S) * FPS, abs=1)
    assert not table.character.is_live


def test_an_edit_is_measured_from_its_intended_moment(table: Table) -> None:
    table.send_plan(0, 2.0)
    table.send_frames(0, 40, 2.0)
    seq = table.character.take_seq(intended_s=2.5)
    table.send_plan(16, 2.7, [seq])
    table.character.take_outcome(session_pb2.EditOutcome(event_seq=seq, effective_frame=16), 2.7)
    table.send_frames(16, 8, 2.75)
    table.character.look(2.79)  # frame 16 is due at 2.8
    assert table.recorder.histogram(SCREEN).get_total_count() == 0
    table.character.look(2.9)
    for what, seconds in ((ANSWER, 0.2), (EVENT, 0.25), (SCREEN, 0.3)):
        assert table.recorder.histogram(what).get_max_value() == pytest.approx(seconds * 1e6, rel=0.01), what
    assert table.recorder.counts["frames_superseded"] == 24
    assert table.recorder.counts["replans"] == 1


def test_an_outcome_may_arrive_after_the_frames(table: Table) -> None:
    table.send_plan(0, 2.0)
    table.send_frames(0, 40, 2.0)
    seq = table.character.take_seq(intended_s=2.5)
    table.send_plan(20, 2.6, [seq])
    table.send_frames(20, 8, 2.6)
    table.send_frames(28, 8, 2.7)
    table.character.take_outcome(session_pb2.EditOutcome(event_seq=seq, effective_frame=20), 2.9)
    table.character.give_up_edits(15.0)
    for what, seconds in ((EVENT, 0.1), (ANSWER, 0.4)):
        assert table.recorder.histogram(what).get_total_count() == 1
        assert table.recorder.histogram(what).get_max_value() == pytest.approx(seconds * 1e6, rel=0.01), what
    assert table.recorder.counts["edits_unanswered"] == 0


def test_edits_without_visible_effect_are_counted_separately(table: Table) -> None:
    table.send_plan(0, 2.0)
    table.send_frames(0, 40, 2.0)
    nothing, beyond, refused = (table.character.take_seq(intended_s=2.5) for _ in range(3))
    table.character.take_outcome(session_pb2.EditOutcome(event_seq=nothing), 2.6)
    table.character.take_outcome(session_pb2.EditOutcome(event_seq=beyond, effective_frame=90), 2.6)
    table.character.take_outcome(session_pb2.EditOutcome(event_seq=refused, code=3), 2.6)
    table.character.give_up_edits(15.0)
    assert table.recorder.counts["edits_that_changed_nothing"] == 1
    assert table.recorder.counts["edits_beyond_the_plan"] == 1
    assert table.recorder.histogram(EVENT).get_total_count() == 0
    assert table.recorder.histogram(ANSWER).get_total_count() == 3


def test_an_unanswered_edit_counts_as_waiting_to_the_end(table: Table) -> None:
    table.character.take_seq(intended_s=3.0)
    table.character.take_seq(intended_s=13.0)  # after measuring
    table.character.give_up_edits(15.0)
    assert table.recorder.counts["edits_unanswered"] == 1
    assert table.recorder.histogram(EVENT).get_max_value() == pytest.approx(12e6, rel=0.01)


def test_frames_out_of_order_are_a_protocol_breach(table: Table) -> None:
    table.send_plan(0, 2.0)
    table.send_frames(0, 8, 2.0)
    table.send_frames(16, 8, 2.1)
    assert table.recorder.counts["protocol_breaches"] == 1
    table.send_plan(24, 2.2)
    table.plan += 1
    table.send_frames(24, 8, 2.2)
    assert table.recorder.counts["protocol_breaches"] == 2


def test_a_plan_that_replaces_shown_frames_is_counted(table: Table) -> None:
    table.send_plan(0, 2.0)
    table.send_frames(0, 40, 2.0)
    table.send_plan(4, 2.5, [9])  # frame 10 is on screen
    assert table.recorder.counts["shown_frames_replaced"] == 1


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 2.0), min_size=1, max_size=12))
def test_every_frame_time_is_either_shown_or_missed(gaps_s: list[float]) -> None:
    """However late chunks arrive; compared with a loop over all frame times."""
    table = Table()
    now_s, first = 0.0, 0
    arrivals = []
    table.send_plan(0, 0.0)
    for gap_s in [0.0, *gaps_s]:
        now_s += gap_s
        arrivals.append((now_s, first + 20))
        table.send_frames(first, 20, now_s)
        first += 20
    shown = missed = 0
    while shown < first:
        at_s = (shown + missed) / FPS
        buffered = max(to for arrived_s, to in arrivals if arrived_s <= at_s + 1e-9)
        if shown < buffered:
            shown += 1
        else:
            missed += 1
    assert table.character.missed == pytest.approx(missed, abs=len(gaps_s))  # a boundary may fall either way
