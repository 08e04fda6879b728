"""How often a session may be replanned, and how its round trip moves its replans and windows."""

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.levels import Level
from motiongen_server.engine.session.edits import EditQueue, PendingEdit
from motiongen_server.engine.types import Code, Priority, ServiceTier
from tests.server.engine.session.playing import num_edit_plans, playing_state
from tests.server.engine.stage import Stage, prompt

HOLD = Level(ServiceTier.HOLD, hold=True)


@pytest.mark.parametrize(("priority", "replans_hz"), list(zip(Priority, EngineConfig().replans_hz, strict=True)))
def test_many_edits_cause_no_more_replans_than_their_class_may_have(priority: Priority, replans_hz: float) -> None:
    stage, viewer, _ = playing_state(priority=priority)
    seqs = []
    for n in range(100):
        seqs.append(stage.set_prompts(viewer, prompt(n)))
        stage.run(0.05)
    assert 0.5 * 5 * replans_hz <= num_edit_plans(viewer) <= 5 * replans_hz + 2
    stage.run(1.5)
    assert all(viewer.outcomes[seq].code is Code.OK for seq in seqs)
    assert viewer.underruns == 0
    stage.check_finished()


def test_the_first_two_edits_after_a_quiet_time_do_not_wait() -> None:
    stage, viewer, _ = playing_state(priority=Priority.CROWD)
    for text in (2, 3):
        seq = stage.set_prompts(viewer, prompt(text))
        stage.run(0.1)
        assert seq in viewer.outcomes
    third = stage.set_prompts(viewer, prompt(4))
    stage.run(0.2)
    assert third not in viewer.outcomes
    stage.run(0.2)
    assert third in viewer.outcomes


def test_one_replan_is_saved_up_however_long_it_was_quiet() -> None:
    stage, viewer, _ = playing_state(priority=Priority.CROWD)
    stage.run(10.0)
    for n in range(20):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.05)
    assert num_edit_plans(viewer) == 3, "two at once, and one after a period"


def test_level_that_scales_the_replan_cap_allows_fewer_replans() -> None:
    stage, viewer, state = playing_state(priority=Priority.NEAR)
    state.set_tier(Level(ServiceTier.FULL, replan_cap_scale=0.2))
    for n in range(80):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.05)
    assert 3 <= num_edit_plans(viewer) <= 6


def test_waiting_for_the_next_replan_is_no_missed_deadline() -> None:
    stage, viewer, _ = playing_state(priority=Priority.CROWD)
    for n in range(60):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.05)
    assert stage.total("deadline_misses") == 0


def test_edits_beyond_max_waiting_edits_are_refused() -> None:
    stage, viewer, state = playing_state(EngineConfig(max_waiting_edits=10, max_prompts=200))
    state.set_tier(HOLD)
    seqs = []
    for n in range(20):
        seqs.append(stage.set_prompts(viewer, prompt(n)))
        stage.run(0.01)
    refused = [viewer.outcomes[seq] for seq in seqs if seq in viewer.outcomes]
    assert len(refused) == 10
    assert {(outcome.code, outcome.reason) for outcome in refused} == {
        (Code.RESOURCE_EXHAUSTED, "TOO_MANY_PENDING_EVENTS")
    }
    assert len(state.edits.waiting) == 10


def test_long_round_trip_makes_replans_start_further_ahead() -> None:
    effective = {}
    for rtt_s in (0.0, 0.5):
        stage, viewer, _ = playing_state()
        viewer.rtt_s = rtt_s
        stage.run_until(lambda stage=stage, viewer=viewer: viewer.buffered_to - viewer.shown > 30)
        shown = viewer.shown
        seq = stage.set_prompts(viewer, prompt(2))
        stage.run(0.2)
        effective[rtt_s] = (viewer.outcomes[seq].effective_frame or 0) - shown
    assert effective[0.5] - effective[0.0] == pytest.approx(0.5 * 20, abs=2)


def test_distant_client_that_reports_its_round_trip_has_no_underruns() -> None:
    underruns = {}
    for rtt_s in (None, 0.8):
        stage = Stage(delay_s=0.4)
        viewer = stage.open(prompts=(prompt(1),), lookahead=60)
        viewer.rtt_s = rtt_s
        stage.runner.step_s = lambda rows: 0.1
        stage.run(5.0)
        before = viewer.underruns
        stage.run(30.0)
        underruns[rtt_s] = viewer.underruns - before
    assert underruns[None] > 0
    assert underruns[0.8] == 0


@pytest.fixture
def queue() -> EditQueue:
    """A queue with an edit that was asked for at 9.8 s."""
    asked = EditQueue(10)
    asked.add(PendingEdit(1, "prompts", 9.8, 0))
    return asked


def test_rest_after_a_replan_counts_from_when_its_edit_was_asked_for(queue: EditQueue) -> None:
    queue.space_replans(10.0, 0.1, 0.5)
    assert queue.not_before == pytest.approx(10.3)
    queue.add(PendingEdit(2, "prompts", 3.0, 0))
    queue.not_before = 0.0
    queue.space_replans(10.0, 0.1, 0.5)
    assert queue.not_before == pytest.approx(10.0), "one rest's credit at most"


def test_replans_are_a_period_apart_after_the_second(queue: EditQueue) -> None:
    starts = []
    now_s = 10.0
    for _ in range(5):
        queue.space_replans(now_s, 0.5, 0.1)
        now_s = max(now_s, queue.not_before)
        starts.append(now_s)
    assert starts == pytest.approx([10.0, 10.3, 10.8, 11.3, 11.8])
