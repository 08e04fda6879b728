"""How many frames of trajectories and paths a session may hold together, however few bytes asked for them."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from motiongen_ardy.locomotion import way
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session import placing
from motiongen_server.engine.types import RootPath, RootTrajectory, Unplaced
from tests.server.engine.session.playing import playing, playing_state
from tests.server.engine.stage import Stage
from tests.server.engine.viewer import Viewer

MOST = 1_000


def _run(constraint_id: int, first_frame: int, frames: int) -> RootTrajectory:
    return RootTrajectory(constraint_id, first_frame, np.zeros((frames, 2), np.float32))


def _path(constraint_id: int, metres: float, speed: float = 1.0) -> Unplaced:
    corners = np.array([[0.0, metres]], np.float32)
    return Unplaced(RootPath(constraint_id, corners, speed, 0.3), False, True, None, True)


def _reason(stage: Stage, viewer: Viewer, *asked: object, **more: object) -> str:
    seq = stage.set_constraints(viewer, *asked, **more)  # type: ignore[arg-type]
    stage.run(0.6)
    return viewer.outcomes[seq].reason


def test_held_trajectory_frames_add_up_without_those_replaced_or_removed() -> None:
    stage, viewer = playing(EngineConfig(max_held_trajectory_frames=MOST))
    assert _reason(stage, viewer, _run(1, 100, 400), _run(2, 500, 400)) == ""
    assert _reason(stage, viewer, _run(3, 900, 201)) == "TOO_MANY_TRAJECTORY_FRAMES"
    assert _reason(stage, viewer, _run(3, 900, 200)) == ""
    assert _reason(stage, viewer, _run(2, 500, 401)) == "TOO_MANY_TRAJECTORY_FRAMES"
    assert _reason(stage, viewer, _run(2, 500, 399)) == "", "the one that it replaces no longer counts"
    assert _reason(stage, viewer, _run(4, 2000, 401), remove=(1,)) == ""
    assert _reason(stage, viewer, _run(5, 2000, MOST), clear=True) == ""


def test_trajectories_of_an_open_count_towards_the_limit() -> None:
    stage = Stage(EngineConfig(max_held_trajectory_frames=MOST))
    viewer = stage.open(1, constraints=(_run(1, 10, 600), _run(2, 700, 401)))
    stage.run(0.1)
    assert viewer.refused is not None
    assert (viewer.refused.reason, viewer.refused.field) == ("TOO_MANY_TRAJECTORY_FRAMES", "open.constraints[1]")


def test_paths_beyond_the_limit_are_not_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    walked = []

    def counted(*arguments: object) -> object:
        walked.append(arguments)
        return way.walked(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(placing, "walked", counted)
    stage, viewer = playing(EngineConfig(max_held_trajectory_frames=MOST))
    assert _reason(stage, viewer, *(_path(number, 20.0) for number in range(1, 200))) == "TOO_MANY_TRAJECTORY_FRAMES"
    assert len(walked) == 3, "each is a walk of some 400 frames"


def test_path_that_takes_too_long_because_of_its_bends_is_refused() -> None:
    corners = np.array([[(-1.0) ** number * 11.0, 0.1 * number] for number in range(256)], np.float32)
    assert np.hypot(*np.diff(corners, axis=0).T).sum() / 10.0 < placing.MOST_PATH_S, "straight on it would be allowed"
    asked = Unplaced(RootPath(1, corners, 10.0, 0.0), False, True, None, True)
    stage, viewer, state = playing_state()
    seq = stage.set_constraints(viewer, asked)
    stage.run(0.6)
    outcome = viewer.outcomes[seq]
    assert (outcome.reason, outcome.field) == ("PATH_TOO_LONG", "edit_constraints.upsert[0].root_path")
    assert state.conditions.constraints == ()


def test_waiting_edits_keep_no_replaced_path_in_memory() -> None:
    stage, viewer = playing(EngineConfig())
    state = stage.engine.sessions[viewer.key]
    seen: list[weakref.ref[RootTrajectory]] = []
    state.edits.wait_until(stage.clock.now() + 5.0)
    for _ in range(20):
        stage.set_constraints(viewer, _path(1, 20.0))
        stage.step()
        (held,) = state.conditions.constraints
        assert isinstance(held, RootTrajectory)
        seen.append(weakref.ref(held.xz))  # type: ignore[arg-type]
    del held
    gc.collect()
    assert sum(each() is not None for each in seen) <= 2


def test_default_limit_is_twenty_minutes_of_walking() -> None:
    assert EngineConfig().max_held_trajectory_frames == 20 * 60 * 20
