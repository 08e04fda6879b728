"""A session that plays, and helpers for tests of it."""

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import PlanCause, Waypoint
from tests.server.engine.fakes import PROMPT
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer


def markers(viewer: Viewer, begin: int, end: int) -> set[int]:
    return {int(row[PROMPT]) for row in viewer.rows[begin:end]}


# the time at which the viewer of `playing` starts to play: after four steps
PLAYS_FROM = 100.04


def waypoint(frame: int, constraint_id: int = 1) -> Waypoint:
    return Waypoint(constraint_id, frame, 1.0, 2.0)


def playing(config: EngineConfig | None = None, **fields: object) -> tuple[Stage, Viewer]:
    """A stage whose only session has played for a second; 4 steps per window, 10 ms per step."""
    stage = Stage(config)
    viewer = stage.open(prompts=(prompt(1),), **fields)
    stage.run(1.0)
    return stage, viewer


def playing_state(config: EngineConfig | None = None, **fields: object) -> tuple[Stage, Viewer, SessionState]:
    """The same, with the engine's state of the session."""
    stage, viewer = playing(config, **fields)
    return stage, viewer, stage.engine.sessions[viewer.key]


def num_edit_plans(viewer: Viewer) -> int:
    """How many plans announced to the viewer were made for edits."""
    return sum(notice.cause is PlanCause.EDIT for notice in viewer.notices)


def start_job(stage: Stage, steps: int) -> None:
    """Let a window of continued playback start and run some of its four steps."""
    before = len(stage.runner.prepared)
    stage.run_until(lambda: len(stage.runner.prepared) > before)
    (job_id,) = stage.runner.jobs
    stage.run_until(lambda: stage.runner.steps[job_id] >= steps)
