"""Windows: the job that is handed to the runner for the window that is due, and what is known of it while it runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from server.engine.conditions import Conditions
from server.engine.config import EngineConfig
from server.engine.drift import Remedy
from server.engine.edits import PendingEdit
from server.engine.ladder import Rung
from server.engine.pose import PoseReader
from server.engine.timeline import Timeline
from server.engine.types import Constraint, Float32Array, Guidance, ModelFacts, SessionSpec, StartPose, WindowJob
from server.engine.velocity import RootState, Velocity, root_state


@dataclass(slots=True)
class RunningWindow:
    """The window being denoised. accept_to: its frames from there on will be dropped. answers: the edits it is for.

    velocity: the one it obeys. remedy: what it rights; fresh: it goes on from no frames before it.
    """

    job: WindowJob
    accept_to: int
    answers: tuple[PendingEdit, ...]
    velocity: Velocity | None
    remedy: Remedy | None
    steps_done: int = 0

    @property
    def first_frame(self) -> int:
        return self.job.first_frame

    @property
    def fresh(self) -> bool:
        return self.remedy is Remedy.FRESH_START


@dataclass(frozen=True, slots=True)
class History:
    """What a window goes on from. features: (H, D); tokens: the same, or None; start_pose: in place of both."""

    features: Float32Array
    tokens: Float32Array | None
    start_pose: StartPose | None

    def __len__(self) -> int:
        return len(self.features)


def history_frames(frame: int, timeline: Timeline, config: EngineConfig, patch: int) -> int:
    """Frames of history of a window that starts at `frame`: whole patches."""
    return min(config.history_crop, (frame - timeline.motion_from) // patch * patch)


def history_of(frame: int, timeline: Timeline, config: EngineConfig, patch: int, remedy: Remedy | None) -> History:
    """The history of a window that goes on from the frames before `frame`."""
    length = history_frames(frame, timeline, config, patch)
    if remedy is Remedy.SHORT_HISTORY:
        length = min(length, patch)
    tokens = timeline.tokens_before(frame, length) if config.reuse_tokens else None
    return History(timeline.features_before(frame, length), tokens, None)


def root_before(frame: int, timeline: Timeline, reader: PoseReader, start: StartPose, fps: int) -> RootState:
    """What the root does just before `frame`; it stands in the start pose before the first."""
    begin = max(timeline.first, frame - 2)
    if frame <= begin:
        return RootState(start.x, start.z, 0.0, 0.0, start.heading)
    rows = timeline.rows_between(begin, frame)
    return root_state(reader.positions(rows), reader.heading(rows[-1]), fps)


def window_conditions(
    conditions: Conditions, first_frame: int, history_length: int, root: RootState, facts: ModelFacts
) -> tuple[Constraint, ...]:
    """The constraints that a window sees. A velocity comes last: it overrides older root targets of its frames."""
    seen = conditions.constraints_within(first_frame, first_frame - history_length + facts.max_window_frames)
    if conditions.velocity is None:
        return seen
    path = conditions.velocity.path(first_frame, first_frame + facts.horizon, root, facts.fps)
    return seen if path is None else (*seen, path)


def guidance_at(rung: Rung, asked: Guidance, has_constraints: bool, facts: ModelFacts) -> Guidance:
    """The guidance of a window at a rung: weights that let evaluations of the denoiser vanish where it drops them.

    Text and constraints that are guided apart cannot both be told in one evaluation; half of each takes two of three.
    """
    if not rung.drop_guidance:
        return asked
    apart = facts.guidance_passes > 2
    return Guidance(0.5, 0.5) if apart and has_constraints else Guidance(1.0, 0.0)


def steps_at(rung: Rung, spec: SessionSpec, facts: ModelFacts) -> int:
    """The denoising steps of a window at a rung: never more than were asked for."""
    if rung.steps is None:
        return spec.denoise_steps
    return min(spec.denoise_steps, max(rung.steps, facts.min_steps))


def no_history(facts: ModelFacts, start_pose: StartPose) -> History:
    return History(np.empty((0, facts.feature_dim), np.float32), None, start_pose)
