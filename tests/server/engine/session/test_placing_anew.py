"""Constraints relative to the character are placed where the window that answers them starts, however late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motiongen_ardy.locomotion.velocity import RootState
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.edits import PendingEdit
from motiongen_server.engine.session.placing import Anchor, placed
from motiongen_server.engine.session.placing_anew import placed_anew
from motiongen_server.engine.types import PlanNotice, RootPath, RootTrajectory, Unplaced, Waypoint
from tests.server.engine.fakes import FACTS, SPEED
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

AHEAD = Unplaced(RootPath(3, np.array([[0.0, 2.0]], np.float32), 1.0, 0.2), is_relative=True)


def anchor(frame: int, x: float) -> Anchor:
    return Anchor(frame, RootState(x, 0.0, 1.0, 0.0, np.pi / 2), FACTS.fps, FACTS.rig)


def pending(asked: Unplaced, at: Anchor) -> tuple[Conditions, PendingEdit]:
    found, placement = placed(asked, at, "")
    return Conditions(constraints=(found,)), PendingEdit(
        1, "constraints", 0.0, at.frame, (placement,), ((asked, found),)
    )


def test_relative_path_begins_where_the_character_is_by_then() -> None:
    conditions, edit = pending(AHEAD, anchor(40, 2.0))
    moved, (renewed,) = placed_anew(conditions, (edit,), anchor(52, 2.6))
    (path,) = moved.constraints
    assert isinstance(path, RootTrajectory)
    assert (path.first_frame, renewed.placements[0].anchor_frame) == (52, 52)
    assert path.xz[-1] == pytest.approx([4.6, 0.0])
    again, (renewed,) = placed_anew(moved, (renewed,), anchor(60, 3.0))
    assert again.constraints[0].first_frame == 60
    assert renewed.left_open[0][1] is again.constraints[0]


def test_placement_is_unchanged_if_the_prediction_was_right() -> None:
    conditions, edit = pending(AHEAD, anchor(40, 2.0))
    assert placed_anew(conditions, (edit,), anchor(40, 2.0)) == (conditions, (edit,))


def test_relative_path_is_placed_anew_if_the_frames_before_it_changed() -> None:
    conditions, edit = pending(AHEAD, anchor(40, 2.0))
    moved, (renewed,) = placed_anew(conditions, (edit,), anchor(40, 50.0))
    assert renewed.placements[0].x == 50.0
    (path,) = moved.constraints
    assert isinstance(path, RootTrajectory)
    assert path.xz[-1] == pytest.approx([52.0, 0.0])


def test_constraint_that_was_replaced_meanwhile_is_not_placed_anew() -> None:
    conditions, edit = pending(AHEAD, anchor(40, 2.0))
    other = replace(conditions, constraints=(Waypoint(3, 90, 1.0, 1.0),))
    moved, (renewed,) = placed_anew(other, (edit,), anchor(52, 2.6))
    assert moved.constraints == other.constraints
    assert renewed.placements[0].anchor_frame == 40


def test_path_that_has_become_too_long_keeps_its_placement() -> None:
    far = Unplaced(RootPath(3, np.array([[599.0, 0.0]], np.float32), 1.0, 0.0))
    conditions, edit = pending(far, anchor(40, 0.0))
    moved, (renewed,) = placed_anew(conditions, (edit,), anchor(52, -2.0))
    assert moved.constraints == conditions.constraints
    assert renewed.placements == edit.placements


IN_30 = Unplaced(Waypoint(3, 30, 5.0, 0.0), frames_from_effect=True)


@pytest.mark.parametrize("last", [replace(IN_30, target=Waypoint(3, 30, -7.0, 0.0)), Waypoint(3, 200, -7.0, 0.0)])
def test_edit_keeps_the_last_of_several_constraints_with_one_id(last: Unplaced | Waypoint) -> None:
    stage = Stage()
    viewer = stage.open(1)
    stage.run(2.0)
    stage.set_prompts(viewer, prompt(2))  # the next replan may not start for a while
    stage.run(0.06)
    seq = stage.set_constraints(viewer, IN_30, last)
    notice = notice_for(stage, viewer, seq)
    (held,) = stage.engine.sessions[viewer.key].conditions.constraints
    assert isinstance(held, Waypoint)
    assert held.x == -7.0
    told = [placement.anchor_frame for placement in viewer.outcomes[seq].placements]
    assert told == ([notice.valid_from] if isinstance(last, Unplaced) else [])


def test_open_keeps_the_last_of_several_constraints_with_one_id() -> None:
    stage = Stage()
    viewer = stage.open(1, constraints=(IN_30, Waypoint(4, 50, 1.0, 0.0), Waypoint(3, 60, 2.0, 0.0)))
    stage.step()
    held = stage.engine.sessions[viewer.key].conditions.constraints
    assert [(item.constraint_id, item.first_frame) for item in held] == [(4, 50), (3, 60)]
    assert viewer.opened is not None
    assert viewer.opened.placements == ()


def notice_for(stage: Stage, viewer: Viewer, seq: int) -> PlanNotice:
    stage.run_until(lambda: seq in viewer.outcomes)
    return next(notice for notice in viewer.notices if seq in notice.event_seqs)


def test_relative_path_asked_for_while_replans_wait_begins_with_its_plan() -> None:
    stage = Stage()
    viewer = stage.open(1)
    stage.run(2.0)
    stage.set_prompts(viewer, prompt(2))  # the next replan may not start for a while
    stage.run(0.06)
    seq = stage.set_constraints(viewer, AHEAD)
    notice = notice_for(stage, viewer, seq)
    (placement,) = viewer.outcomes[seq].placements
    assert placement.anchor_frame == placement.first_frame == notice.valid_from
    assert placement.x == pytest.approx((notice.valid_from - 1) * SPEED / FACTS.fps, abs=1e-4)
    job = next(job for job in stage.runner.prepared if job.first_frame == notice.valid_from and job.plan == notice.plan)
    (path,) = (item for item in job.constraints if isinstance(item, RootTrajectory))
    assert path.first_frame == notice.valid_from
