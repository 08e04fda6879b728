"""Characters that lean, sink or fly off: what is detected, and how a session corrects them."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.drift import Correction, DriftGuard
from motiongen_server.engine.session.pose import PoseReader
from motiongen_server.engine.types import ChannelBlock, Closed, PlanCause, StartPose, WindowJob
from tests.server.engine.fakes import FACTS, ROW_WIDTH
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

GUARD = DriftGuard(PoseReader.of(FACTS.rig), EngineConfig())


def _rows(*, lean: float = 0.0, heading: float = 0.0, y: float = 1.0, x: float = 0.0, num: int = 40) -> np.ndarray:
    """Rows of a root that faces `heading` and leans forward by `lean`: a turn about Y after one about X."""
    rows = np.zeros((num, ROW_WIDTH), np.float32)
    rows[:, 0], rows[:, 1] = x, y
    half, tilt = heading / 2, lean / 2
    rows[:, 3:7] = [
        math.cos(half) * math.cos(tilt),
        math.cos(half) * math.sin(tilt),
        math.sin(half) * math.cos(tilt),
        -math.sin(half) * math.sin(tilt),
    ]
    return rows


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5, 3.1])
@pytest.mark.parametrize("lean", [0.0, 0.4, -0.9, 1.5])
def test_lean_and_heading_are_read_from_the_roots_rotation(heading: float, lean: float) -> None:
    rows = _rows(heading=heading, lean=lean)
    assert GUARD.reader.lean(rows) == pytest.approx(abs(lean), abs=1e-3)
    assert GUARD.reader.heading(rows[0]) == pytest.approx(heading, abs=1e-5)


@pytest.mark.parametrize(
    ("rows", "correction"),
    [
        (_rows(), None),
        (_rows(lean=0.9), None),
        (_rows(lean=1.2), Correction.SHORT_HISTORY),
        (np.concatenate((_rows(lean=1.5, num=20), _rows(num=20))), None),
        (_rows(y=-0.6), Correction.FRESH_START),
        (np.concatenate((_rows(num=39), _rows(y=4.1, num=1))), Correction.FRESH_START),
        (_rows(x=-20_001.0), Correction.FRESH_START),
        (_rows(x=-10_050.0), None),
        (_rows(y=math.nan), Correction.FRESH_START),
        (_rows(x=math.inf), Correction.FRESH_START),
    ],
)
def test_correction_depends_on_lean_height_and_position(rows: np.ndarray, correction: Correction | None) -> None:
    assert GUARD.correction(rows) is correction


def test_fresh_start_is_where_the_character_was_within_bounds() -> None:
    pose = GUARD.fresh_start(_rows(x=12.0, heading=1.5, y=-7.0)[0])
    assert (pose.x, pose.z, pose.heading) == pytest.approx((12.0, 0.0, 1.5))
    assert GUARD.fresh_start(_rows(x=30_000.0)[0]).x == 20_000.0


def test_drift_guard_that_is_off_corrects_nothing() -> None:
    guard = DriftGuard(GUARD.reader, EngineConfig(guard_drift=False))
    assert guard.correction(_rows(y=50.0, lean=1.5)) is None


CONTACTS = PoseReader.of(replace(FACTS.rig, blocks=(*FACTS.rig.blocks[:2], ChannelBlock("foot_contact", 2))))


def _contacts(told: str) -> np.ndarray:
    """A row for each letter: o with the left foot on the ground, _ in the air."""
    rows = np.zeros((len(told), ROW_WIDTH), np.float32)
    rows[:, 7] = [each == "o" for each in told]
    return rows


@pytest.mark.parametrize(
    ("told", "floats_from"),
    [
        ("oooo", None),
        ("o___o___", None),
        ("o____o", 1),
        ("____oo", 0),
        ("oo___o_____", 6),
        ("oo_______", 2),
        ("", None),
    ],
)
def test_flight_begins_where_no_foot_touches_the_ground_for_too_long(told: str, floats_from: int | None) -> None:
    assert CONTACTS.flight(_contacts(told), 4) == floats_from


def test_no_flight_is_found_without_contacts_a_limit_or_the_guard() -> None:
    assert GUARD.reader.flight(_contacts("_" * 50), 4) is None
    assert DriftGuard(CONTACTS, EngineConfig()).flight(_contacts("_" * 50)) is None
    assert DriftGuard(CONTACTS, EngineConfig(guard_drift=False), 4).flight(_contacts("_" * 50)) is None
    assert DriftGuard(CONTACTS, EngineConfig(), 4).flight(_contacts("_" * 50)) == 0


# ---- in a session ----------------------------------------------------------------------------------------------------


def _stage(moves: "dict[int, np.ndarray]", config: EngineConfig | None = None) -> tuple[Stage, Viewer]:
    """A session whose windows of these plans have these rows: root position and rotation."""
    stage = Stage(config)
    stage.runner.rights = True

    def move(job: WindowJob, frames: np.ndarray) -> None:
        if job.plan in moves:
            frames[:, :7] = moves[job.plan][:, :7]

    stage.runner.moves = move
    viewer = stage.open(prompts=(prompt(1),))
    return stage, viewer


def _lost_late() -> tuple[Stage, Viewer]:
    """A session whose third window is lost, and lands when the frames before it have almost been played."""
    config = EngineConfig(continue_threshold=1, continue_jitter=0)
    stage, viewer = _stage({3: _rows(y=9.0, x=3.0, heading=0.7)}, config)
    stage.runner.step_s = lambda rows: 0.05
    return stage, viewer


def test_leaning_character_gets_a_short_history_and_no_gap() -> None:
    stage, viewer = _stage({2: _rows(lean=1.3)})
    stage.run(12.0)
    assert [len(job.history) for job in stage.runner.prepared][:5] == [0, 16, 4, 16, 16]
    assert [notice.cause for notice in viewer.notices][:4] == [
        PlanCause.CONTINUE,
        PlanCause.CONTINUE,
        PlanCause.FALLBACK,
        PlanCause.CONTINUE,
    ]
    assert stage.total("soft_resets") == 1
    assert viewer.underruns == 0
    assert [notice.valid_from for notice in viewer.notices][:4] == [0, 40, 80, 120]


def test_lost_character_continues_from_earlier_frames_if_there_is_time() -> None:
    stage, viewer = _stage({2: _rows(y=9.0)})
    stage.run(8.0)
    righting = next(job for job in stage.runner.prepared if job.plan == 3)
    notice = next(notice for notice in viewer.notices if notice.plan == 3)
    assert (notice.cause, notice.valid_from) == (PlanCause.FALLBACK, righting.first_frame)
    assert viewer.position > righting.first_frame < 40
    assert (len(righting.history), righting.start_pose) == (4, None)
    assert {float(row[1]) for row in viewer.rows} == {1.0}
    assert stage.total("soft_resets") == 1


def test_character_whose_lost_window_lands_late_gets_a_fresh_start() -> None:
    stage, viewer = _lost_late()
    stage.run(8.0)
    fresh = next(job for job in stage.runner.prepared if job.first_frame and job.start_pose)
    assert fresh.start_pose == StartPose(pytest.approx(3.0), 0.0, pytest.approx(0.7, abs=1e-5))
    assert (len(fresh.history), fresh.history_tokens) == (0, None)
    notice = next(notice for notice in viewer.notices if notice.plan == 4)
    assert notice.cause is PlanCause.FALLBACK
    assert 80 < notice.valid_from == fresh.first_frame < 120
    later = [job for job in stage.runner.prepared if job.plan > 4]
    assert all(len(job.history) == min(16, job.first_frame - fresh.first_frame) for job in later)
    assert stage.total("soft_resets") == 1
    stage.check_finished()


def test_an_edit_soon_after_a_fresh_start_has_no_history_from_before_it() -> None:
    stage, viewer = _lost_late()
    stage.run_until(lambda: len(viewer.notices) == 4)
    stage.runner.step_s = lambda rows: 0.001
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(2.0)
    fresh, after = [job for job in stage.runner.prepared if job.plan in (4, 5)]
    assert fresh.start_pose is not None
    assert after.first_frame == viewer.outcomes[seq].effective_frame
    assert len(after.history) == (after.first_frame - fresh.first_frame) // 4 * 4 == 4
    stage.check_finished()


def test_edit_of_a_lost_character_corrects_it_too() -> None:
    stage, viewer = _stage({2: _rows(y=9.0)})
    stage.run_until(lambda: len(viewer.notices) == 2)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.run(1.0)
    assert viewer.outcomes[seq].effective_frame is not None
    assert stage.total("soft_resets") == 1


def test_corrections_of_an_always_lost_character_stay_within_the_replan_cap() -> None:
    lost = _rows(y=9.0)
    stage, viewer = _stage(dict.fromkeys(range(1, 10_000), lost))
    stage.run(20.0)
    assert 20 < stage.total("soft_resets") <= 20 * 5 + 2
    assert not isinstance(stage.outputs[-1], Closed)
    assert viewer.underruns == 0


# The last number of a row: 1 where the left foot is on the ground. Other tests do not read it.
FLYING = replace(
    FACTS, longest_flight=30,
    rig=replace(FACTS.rig, blocks=(*FACTS.rig.blocks[:2], ChannelBlock("rest", 4), ChannelBlock("foot_contact", 1))),
)  # fmt: skip


def _flying(in_the_air: Callable[[int], bool]) -> tuple[Stage, Viewer]:
    """A session that is in the air at some frames, until it starts anew."""
    stage = Stage(facts=FLYING)
    stage.runner.rights = True

    def move(job: WindowJob, frames: np.ndarray) -> None:
        fresh = any(each.start_pose and each.first_frame for each in stage.runner.prepared)
        first = job.first_frame
        frames[:, -1] = [fresh or not in_the_air(frame) for frame in range(first, first + len(frames))]

    stage.runner.moves = move
    return stage, stage.open(prompts=(prompt(1),))


def test_floating_character_gets_one_fresh_start_where_it_is() -> None:
    stage, viewer = _flying(lambda frame: frame >= 30)  # ten frames of one window, and on
    stage.run(10.0)
    (fresh,) = (job for job in stage.runner.prepared if job.start_pose and job.first_frame)
    assert fresh.start_pose == StartPose(pytest.approx(0.025 * (fresh.first_frame - 1), abs=1e-4), 0.0, 0.0)
    assert 30 < fresh.first_frame < 90
    assert stage.total("soft_resets") == 2, "first with a short history, from before it floats, which does not help"
    assert viewer.underruns == 0
    stage.check_finished()


def test_character_that_is_in_the_air_only_briefly_is_not_corrected() -> None:
    stage, _ = _flying(lambda frame: frame % 31 > 1)  # 29 frames at a time, across windows
    stage.run(10.0)
    assert not stage.total("soft_resets")


@pytest.mark.parametrize("paused", [True, False])
def test_lost_character_is_not_computed_again_while_it_is_not_played(paused: bool) -> None:
    """From the same frame it would be lost again and again."""
    stage, viewer = _stage({plan: _rows(y=9.0) for plan in range(2, 1000)} if paused else {})
    if not paused:
        stage.silent.add(viewer.key)  # it never begins to play
        stage.runner.moves = lambda job, frames: frames.__setitem__((slice(None), 1), 9.0)
    stage.run(2.0)
    if paused:
        stage.pause(viewer, True)
        stage.run(1.0)
        stage.set_prompts(viewer, prompt(2))
        stage.run(1.0)
    before = len(stage.runner.prepared)
    stage.run(20.0)
    assert len(stage.runner.prepared) - before <= 1
