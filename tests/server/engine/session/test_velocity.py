"""Velocities: the trajectory they become in a window, how long they hold, and what a session makes of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_ardy.locomotion.velocity import SLOWING_FRAMES, RootState, root_state
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.velocity import Velocity, changed_velocity
from motiongen_server.engine.types import Code, PlanCause, RootTrajectory, SessionKey, SetVelocity, Waypoint
from tests.server.engine.fakes import SPEED
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

FPS = 20
AT_REST = RootState(1.0, 2.0, 0.0, 0.0, 0.0)


def _event(x: float, z: float, heading: float | None = None, hold_frames: int = 40) -> SetVelocity:
    return SetVelocity(SessionKey(1, 1), 1, 0.0, x, z, heading, hold_frames)


@given(
    velocity=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    before=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    begin=st.integers(0, 10_000),
    hold_frames=st.integers(1, 400),
)
def test_path_starts_at_the_root_and_reaches_the_velocity(
    velocity: tuple[float, float], before: tuple[float, float], begin: int, hold_frames: int
) -> None:
    root = RootState(5.0, -7.0, *before, 0.0)
    heading = math.atan2(*velocity)
    path = Velocity(*velocity, heading, hold_frames).path(begin, begin + 80, root, FPS)
    assert path is not None
    assert path.first_frame == begin
    slowing = 0 if velocity == (0.0, 0.0) else SLOWING_FRAMES
    assert len(path.xz) == min(80, hold_frames + slowing)
    steps = (np.diff(np.concatenate(([[5.0, -7.0]], path.xz)), axis=0) * FPS)[: min(80, hold_frames)]
    ramp = math.ceil(FPS * max(0.3, math.dist(velocity, before) / 2.2))
    assert steps[ramp:] == pytest.approx(np.broadcast_to(velocity, steps[ramp:].shape), abs=1e-3)
    low, high = np.minimum(velocity, before) - 1e-3, np.maximum(velocity, before) + 1e-3
    assert ((steps >= low) & (steps <= high)).all()


@pytest.mark.parametrize(("speed", "within_s"), [(0.5, 1.0), (1.5, 1.0), (3.0, 2.0)])
def test_speed_is_reached_in_the_time_that_people_take(speed: float, within_s: float) -> None:
    path = Velocity(0.0, speed, None, 100).path(0, 60, RootState(0.0, 0.0, 0.0, 0.0, 0.0), FPS)
    assert path is not None
    reached = np.diff(path.xz[:, 1]) * FPS
    assert reached[int(within_s * FPS) :] == pytest.approx(speed, rel=0.01)
    assert np.abs(np.diff(reached)).max() * FPS < 3.0


def test_reversed_velocity_turns_the_root_instead_of_walking_backwards() -> None:
    for root in (RootState(0.0, 0.0, 0.0, 1.5, 0.0), RootState(0.0, 0.0, 0.0, 0.0, 0.0)):
        path = Velocity(0.0, -1.5, None, 200).path(0, 80, root, FPS)
        assert path is not None
        assert path.heading is not None
        speed = np.diff(path.xz[:, 1], prepend=0.0) * FPS
        assert (speed * np.cos(path.heading) > -0.15).all()
        assert math.remainder(float(path.heading[-1]) - math.pi, math.tau) == pytest.approx(0.0, abs=1e-5)
        assert speed[50] == pytest.approx(-1.5, abs=0.01)


def test_requested_heading_is_kept_whatever_the_direction() -> None:
    path = Velocity(0.0, -1.0, 0.0, 40).path(0, 40, RootState(0.0, 0.0, 0.0, 0.0, 0.0), FPS)
    assert path is not None
    assert path.heading is not None
    assert np.abs(path.heading).max() == 0.0


def test_velocity_that_ends_slows_to_a_stop() -> None:
    velocity = Velocity(1.5, 0.0, None, 20, steers_from=100)
    path = velocity.path(100, 140, RootState(0.0, 0.0, 1.5, 0.0, math.pi / 2), FPS)
    assert path is not None
    speed = np.diff(path.xz[:, 0], prepend=0.0) * FPS
    assert speed[:20] == pytest.approx(1.5, abs=1e-3)
    assert speed[20:] == pytest.approx(1.5 * (1 - np.arange(1, 17) / 16), abs=1e-3)
    later = velocity.path(128, 168, RootState(2.0, 0.0, 0.7, 0.0, math.pi / 2), FPS)
    assert later is not None
    assert len(later.xz) == 8
    assert np.diff(later.xz[-2:, 0])[0] == pytest.approx(0.0, abs=1e-6)
    assert velocity.path(136, 176, AT_REST, FPS) is None


def test_zero_velocity_is_a_path_that_comes_to_rest() -> None:
    path = Velocity(0.0, 0.0, None, 40).path(100, 140, RootState(0.0, 0.0, 1.0, 0.0, 0.0), FPS)
    assert path is not None
    assert len(path.xz) == 40
    assert (path.xz[10:] == path.xz[10]).all()
    assert 0 < path.xz[10, 0] < 0.3


@pytest.mark.parametrize(("before", "asked"), [(3.0, -3.0), (-3.0, 3.0), (0.0, 9 * math.tau + 0.5)])
def test_headings_turn_the_short_way(before: float, asked: float) -> None:
    path = Velocity(0.0, 1.0, asked, 40).path(0, 40, RootState(0.0, 0.0, 0.0, 0.0, before), FPS)
    assert path is not None
    assert path.heading is not None
    assert np.abs(np.diff(path.heading, prepend=before)).max() < math.pi / 6
    assert math.remainder(float(path.heading[-1]) - asked, math.tau) == pytest.approx(0.0, abs=1e-5)


def test_velocity_ends_after_its_hold_frames_and_the_slowing_down() -> None:
    velocity = Velocity(1.0, 0.0, None, 50, steers_from=100)
    path = velocity.path(140, 180, AT_REST, FPS)
    assert path is not None
    assert path.last_frame == 149 + SLOWING_FRAMES
    assert velocity.path(150 + SLOWING_FRAMES, 230, AT_REST, FPS) is None


def test_repeated_velocity_changes_only_where_it_ends() -> None:
    held = Velocity(1.0, 0.0, 0.5, 40, steers_from=100)
    again, dirty_from, prolongs = changed_velocity(held, _event(1.0, 0.0, 0.5), floor=120)
    assert (again.end_if_from(0), dirty_from, prolongs) == (160, 140, True)
    shorter, dirty_from, prolongs = changed_velocity(held, _event(1.0, 0.0, 0.5, hold_frames=5), floor=120)
    assert (shorter.end_if_from(0), dirty_from, prolongs) == (125, 125, False)
    assert changed_velocity(held, _event(1.0, 0.0, 0.5), floor=100) == (held, None, False)
    for other in (_event(1.1, 0.0, 0.5), _event(1.0, 0.0), _event(1.0, 0.1, 0.5)):
        assert changed_velocity(held, other, floor=120)[1:] == (120, False)
    assert changed_velocity(held, _event(1.0, 0.0, 0.5), floor=140)[1:] == (140, False)


def test_the_root_state_is_read_from_the_last_few_frames() -> None:
    positions = np.array([[9, 9, 9], [0.8, 1, 2.4], [0.9, 1, 2.3], [1, 1, 2], [1.1, 1, 1.8]], np.float32)
    state = root_state(positions[:, [0, 2]], 0.25, FPS)
    assert (state.x, state.z, state.heading) == pytest.approx((1.1, 1.8, 0.25))
    assert (state.speed_x, state.speed_z) == pytest.approx((2.0, -4.0), abs=1e-4)
    assert root_state(positions[:1, [0, 2]], 0.0, FPS) == RootState(9.0, 9.0, 0.0, 0.0, 0.0)


# ---- in a session ----------------------------------------------------------------------------------------------------


def _playing(config: EngineConfig | None = None) -> tuple[Stage, Viewer]:
    stage = Stage(config)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(1.0)
    return stage, viewer


def _paths(stage: Stage) -> list[tuple[int, RootTrajectory]]:
    """First frame and velocity path of every window that had one."""
    found = []
    for job in stage.runner.prepared:
        found += [(job.first_frame, item) for item in job.constraints if isinstance(item, RootTrajectory)]
    return found


def test_a_velocity_replans_at_once_from_where_the_root_is() -> None:
    stage, viewer = _playing()
    seq = stage.set_velocity(viewer, 0.0, 1.5)
    stage.run(0.1)
    outcome = viewer.outcomes[seq]
    notice = viewer.notices[-1]
    assert (outcome.code, notice.cause, notice.event_seqs) == (Code.OK, PlanCause.EDIT, (seq,))
    assert outcome.effective_frame == notice.valid_from <= viewer.shown + 10
    ((frame, path),) = _paths(stage)
    assert frame == path.first_frame == notice.valid_from
    assert len(path.xz) == 40
    root, step = (frame - 1) * SPEED / FPS, 2.2 / FPS / math.hypot(SPEED, 1.5)
    assert path.xz[0] == pytest.approx([root + SPEED / FPS * (1 - step), 1.5 / FPS * step], abs=1e-3)
    assert path.heading is not None
    assert path.heading[-1] == pytest.approx(0.0, abs=1e-5)


def test_a_velocity_holds_over_windows_and_ends_by_itself() -> None:
    stage, viewer = _playing()
    seq = stage.set_velocity(viewer, 1.0, 0.0, hold_frames=60)
    stage.run(10.0)
    start = viewer.outcomes[seq].effective_frame
    assert start is not None
    covered = [frame for _, path in _paths(stage) for frame in range(path.first_frame, path.last_frame + 1)]
    assert covered == list(range(start, start + 60 + SLOWING_FRAMES))
    assert stage.engine.sessions[viewer.key].conditions.velocity is None


def test_each_velocity_replaces_the_last_and_each_is_answered() -> None:
    stage, viewer = _playing()
    seqs = [stage.set_velocity(viewer, float(n), 0.0) for n in range(5)]
    stage.run(0.1)
    assert {viewer.outcomes[seq].effective_frame for seq in seqs} == {viewer.notices[-1].valid_from}
    (path,) = [path for _, path in _paths(stage)]
    assert path.xz[39, 0] - path.xz[38, 0] == pytest.approx(4.0 / FPS, abs=1e-4)


def test_velocity_repeated_while_it_holds_causes_no_replan() -> None:
    stage, viewer = _playing()
    stage.set_velocity(viewer, 1.0, 0.0, hold_frames=200)
    stage.run(2.0)
    shown, plans = viewer.shown, len([notice for notice in viewer.notices if notice.cause is PlanCause.EDIT])
    seq = stage.set_velocity(viewer, 1.0, 0.0, hold_frames=200)
    stage.run(15.0)
    assert viewer.outcomes[seq].code is Code.OK
    assert len([notice for notice in viewer.notices if notice.cause is PlanCause.EDIT]) == plans
    assert shown + 200 < max(path.last_frame for _, path in _paths(stage)) <= shown + 210 + SLOWING_FRAMES


def test_waypoint_of_the_client_follows_and_so_overrides_the_velocity_path() -> None:
    stage, viewer = _playing()
    stage.set_constraints(viewer, Waypoint(1, 60, 9.0, 9.0))
    stage.set_velocity(viewer, 1.0, 0.0)
    stage.run(0.1)
    path, target = stage.runner.prepared[-1].constraints  # of two that disagree the later one wins
    assert isinstance(path, RootTrajectory)
    assert target == Waypoint(1, 60, 9.0, 9.0)
    assert path.constraint_id != target.constraint_id


def test_velocity_before_the_first_frame_starts_from_the_start_pose() -> None:
    stage = Stage()
    viewer = stage.open()
    seq = stage.set_velocity(viewer, 0.0, 2.0, heading=0.0)
    stage.run(0.1)
    assert viewer.outcomes[seq].effective_frame == 0
    ((_, path),) = _paths(stage)
    assert path.xz[0] == pytest.approx([0.0, 2.2 / FPS**2], abs=1e-6)
    assert path.heading is not None


def test_hold_time_of_a_velocity_does_not_start_with_a_discarded_window() -> None:
    stage, viewer = _playing(EngineConfig(continue_threshold=10))
    stage.run_until(lambda: viewer.buffered_to - viewer.shown > 30)
    slow = iter([0.2] * 4)
    stage.runner.step_s = lambda rows: next(slow, 0.01)
    seq = stage.set_velocity(viewer, 1.0, 0.0, hold_frames=50)
    stage.run(6.0)
    assert stage.total("windows_discarded") == 1
    start = viewer.outcomes[seq].effective_frame
    assert start is not None
    assert max(path.last_frame for _, path in _paths(stage)) == start + 49 + SLOWING_FRAMES
