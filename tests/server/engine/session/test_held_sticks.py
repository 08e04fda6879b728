"""A held stick: the same velocity, sent many times a second, is not replanned each time."""

import pytest

from motiongen_server.engine.types import Code, RootTrajectory
from tests.server.engine.fakes import FACTS, PLAN, SPEED
from tests.server.engine.session.playing import num_edit_plans, playing
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

HELD = SPEED, 0.0


def steer(stage: Stage, viewer: Viewer, seconds: float, hold_frames: int, hz: float = 10.0) -> list[int]:
    """Send the same velocity again and again. Returns the numbers of the events."""
    seqs = []
    for _ in range(round(seconds * hz)):
        seqs.append(stage.set_velocity(viewer, *HELD, hold_frames=hold_frames))
        stage.run(1.0 / hz)
    return seqs


def leads(stage: Stage, viewer: Viewer, frame: int) -> bool:
    """Whether the plan that a frame belongs to goes at the velocity there, and does not slow down."""
    plan = int(viewer.rows[frame][PLAN])
    (job,) = (job for job in stage.runner.prepared if job.plan == plan)
    for path in job.constraints:
        if isinstance(path, RootTrajectory) and path.first_frame <= frame - 1 and frame <= path.last_frame:
            step = path.xz[frame - path.first_frame] - path.xz[frame - 1 - path.first_frame]
            return step[0] == pytest.approx(SPEED / FACTS.fps, rel=0.01)
    return frame == job.first_frame


@pytest.mark.parametrize(("hold_frames", "most_plans"), [(10, 42), (20, 22), (60, 22)])
def test_held_stick_is_replanned_only_as_its_velocity_runs_out(hold_frames: int, most_plans: int) -> None:
    stage, viewer = playing()
    steer(stage, viewer, 2.0, hold_frames)
    begun, first_shown = num_edit_plans(viewer), viewer.shown
    steer(stage, viewer, 10.0, hold_frames)
    assert num_edit_plans(viewer) - begun <= most_plans, "it was sent 100 times"
    slow = [frame for frame in range(first_shown, viewer.shown) if not leads(stage, viewer, frame)]
    assert slow == [], "it never slows down between two events"
    assert stage.total("deadline_misses") == 0
    stage.run(1.0)
    stage.check_finished()


def test_replans_of_a_held_stick_begin_on_the_token_grid() -> None:
    stage, viewer = playing()
    steer(stage, viewer, 2.0, hold_frames=20)
    before = len(stage.runner.prepared)
    steer(stage, viewer, 5.0, hold_frames=20)
    assert len(stage.runner.prepared) > before + 5
    assert all(job.history_tokens is not None for job in stage.runner.prepared[before:])


def test_each_repeated_velocity_is_answered_within_650_ms() -> None:
    stage, viewer = playing()
    said: dict[int, float] = {}
    late = []
    for _ in range(60):
        said[stage.set_velocity(viewer, *HELD, hold_frames=200)] = stage.clock.now()
        stage.run(0.1)
        late += [seq for seq, at in said.items() if seq not in viewer.outcomes and stage.clock.now() - at > 0.65]
    stage.run(1.0)
    assert late == []
    assert all(viewer.outcomes[seq].code is Code.OK for seq in said)


def test_changed_velocity_does_not_wait() -> None:
    stage, viewer = playing()
    steer(stage, viewer, 2.0, hold_frames=40)
    stage.set_velocity(viewer, *HELD, hold_frames=40)
    stage.run(0.02)
    seq = stage.set_velocity(viewer, 0.0, SPEED, hold_frames=40)
    stage.run(0.15)
    assert viewer.outcomes[seq].code is Code.OK


def test_prompt_set_while_a_stick_is_held_does_not_wait() -> None:
    stage, viewer = playing()
    steer(stage, viewer, 2.0, hold_frames=40)
    stage.set_velocity(viewer, *HELD, hold_frames=40)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(0.2)
    assert viewer.outcomes[seq].code is Code.OK


def test_repeated_velocity_is_answered_at_once_while_paused() -> None:
    stage, viewer = playing()
    steer(stage, viewer, 2.0, hold_frames=40)
    stage.pause(viewer, True)
    stage.run(0.2)
    seq = stage.set_velocity(viewer, *HELD, hold_frames=60)
    stage.run(0.2)
    assert viewer.outcomes[seq].code is Code.OK


def test_prolonged_velocities_do_not_count_in_the_latencies_of_edits() -> None:
    stage, viewer = playing()
    steer(stage, viewer, 6.0, hold_frames=40)
    kinds = [each.kind for report in stage.reports for each in report.event_latencies]
    assert kinds.count("velocity") <= 2, "the first, and those sent before it had landed"


@pytest.mark.parametrize(("hz", "step_s"), [(60.0, 0.01), (20.0, 0.03)])
def test_velocity_repeated_faster_than_windows_land_is_not_always_replanned(hz: float, step_s: float) -> None:
    """The window that obeys it was made for an earlier event with the same velocity."""
    stage, viewer = playing()
    stage.runner.step_s = lambda rows: step_s
    steer(stage, viewer, 2.0, hold_frames=60, hz=hz)
    begun = num_edit_plans(viewer)
    steer(stage, viewer, 4.0, hold_frames=60, hz=hz)
    assert num_edit_plans(viewer) - begun <= 4


@pytest.mark.parametrize("slow_s", [0.01, 0.05, 0.1])
def test_velocity_repeated_just_before_a_window_lands_holds_its_full_time(
    slow_s: float,
) -> None:
    stage, viewer = playing()
    state = stage.engine.sessions[viewer.key]
    stage.set_velocity(viewer, *HELD, hold_frames=10)
    stage.run_until(lambda: state.running is not None and state.running.steps_done == 2)
    stage.runner.step_s = lambda rows: slow_s  # so that frames pass between its start and what can still change
    stage.run_until(lambda: state.running is not None and state.running.steps_done == 3)
    floor = state.replaceable_from(stage.clock.now(), state.delivery.commit_s)
    stage.set_velocity(viewer, *HELD, hold_frames=10)
    stage.runner.step_s = lambda rows: 0.01
    stage.run_until(lambda: state.running is None and not state.edits.waiting)
    assert state.conditions.velocity is not None
    assert state.conditions.velocity.end_if_from(0) >= floor + 10
