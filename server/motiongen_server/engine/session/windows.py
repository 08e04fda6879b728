"""Windows: builds the runner's job for a session's next window, and keeps what is known of it while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from motiongen_ardy.locomotion.velocity import STATE_FRAMES, RootState, root_state
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.levels import Level
from motiongen_server.engine.session.aiming import Aiming
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.course import behind_places
from motiongen_server.engine.session.cutting import Cut
from motiongen_server.engine.session.drift import Correction, DriftGuard
from motiongen_server.engine.session.edits import PendingEdit
from motiongen_server.engine.session.pose import PoseReader
from motiongen_server.engine.session.precedence import in_force
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.session.velocity import Velocity
from motiongen_server.engine.types import (
    Constraint,
    Guidance,
    ModelFacts,
    PlanCause,
    RootTrajectory,
    SessionSpec,
    StartPose,
    WindowJob,
)


@dataclass(slots=True)
class RunningWindow:
    """The window being denoised. accept_to: its frames from there on will be dropped. answers: the edits it is for.

    velocity: the one that it obeys. correction: what it corrects. cut: what it continues from, if not from the frames
    before it.
    """

    job: WindowJob
    accept_to: int
    answers: tuple[PendingEdit, ...]
    velocity: Velocity | None
    correction: Correction | None
    fps: int
    steps_done: int = 0
    cut: Cut | None = None

    @property
    def first_frame(self) -> int:
        return self.job.first_frame

    def late_share(self, now: float) -> float:
        """How long the client has waited for this window, relative to the playing time of its frames; at most 1."""
        length_s = max(1, self.accept_to - self.first_frame) / self.fps
        return min(1.0, max(0.0, now - self.job.deadline) / length_s)

    @property
    def fresh(self) -> bool:
        """Whether it does not continue the frames before it."""
        return self.job.start_pose is not None or self.cut is not None


class Due(NamedTuple):
    """A window's job number, its steps, and when it must be done; fields as in `WindowJob`."""

    job_id: int
    num_steps: int
    created_at: float
    deadline: float
    runs_out_at: float


@dataclass(frozen=True, slots=True)
class WindowSite:
    """What a session's next window is built from."""

    spec: SessionSpec
    facts: ModelFacts
    config: EngineConfig
    guard: DriftGuard
    level: Level
    conditions: Conditions
    timeline: Timeline

    def job(self, first_frame: int, correction: Correction | None, plan: int, cause: PlanCause, due: Due) -> WindowJob:
        """The job of a window from first_frame on."""
        start_pose = self._start_pose(first_frame, correction)
        crop = history_crop(self.spec, self.config)
        length = 0 if start_pose else history_frames(first_frame, self.timeline, crop, self.facts.patch)
        if correction is Correction.SHORT_HISTORY:
            length = min(length, self.facts.patch)
        prompt = self.conditions.prompt_at(first_frame)
        path = self._velocity_path(first_frame)
        constraints = self._constraints(first_frame, length, path)
        return WindowJob(
            job_id=due.job_id,
            session=self.spec.session,
            plan=plan,
            first_frame=first_frame,
            history=self.timeline.features_before(first_frame, length),
            start_pose=start_pose,
            embedding=None if prompt is None else prompt.embedding,
            constraints=constraints,
            seed=self.spec.seed,
            num_steps=due.num_steps,
            guidance=guidance_at(self.level, self.spec.guidance, bool(constraints), self.facts),
            deadline=due.deadline,
            priority=self.spec.priority,
            cause=cause,
            created_at=due.created_at,
            history_tokens=self.timeline.tokens_before(first_frame, length) if self.config.reuse_tokens else None,
            background=self.spec.is_clip,
            # a velocity's prompt was chosen to fit it
            keep_prompt=self.spec.keep_prompts or any(each is path for each in constraints),
            owner=self.spec.owner,
            runs_out_at=due.runs_out_at,
        )

    def _start_pose(self, first_frame: int, correction: Correction | None) -> StartPose | None:
        """Where a window without history starts; None for one that continues the frames before it."""
        if first_frame == self.timeline.first:  # nothing is held before it
            return self.spec.start_pose
        if correction is not Correction.FRESH_START:
            return None
        return self.guard.fresh_start(self.timeline.rows_between(first_frame - 1, first_frame)[0])

    def _constraints(
        self, first_frame: int, history_length: int, path: RootTrajectory | None
    ) -> tuple[Constraint, ...]:
        """The constraints that a window sees. The client's win over a velocity, and heavier over lighter ones."""
        end = first_frame - history_length + self.facts.max_window_frames
        held = self.conditions.constraints_within(first_frame, end)
        if not held:
            return () if path is None else (path,)
        aiming = Aiming(self.facts.rig, self.facts.fps, self.timeline, range(first_frame, end), self.root_before)
        seen = in_force(aiming.aimed(held), aiming.window, self.facts.fps)
        lead = aiming.lead(held, first_frame + self.facts.horizon)
        leads = behind_places(path if lead is None else lead, seen, aiming.window)
        return (*(() if leads is None else (leads,)), *aiming.free_roots(seen, leads), *seen)

    def _velocity_path(self, first_frame: int) -> RootTrajectory | None:
        """The path of a velocity through a window; None if none leads there."""
        velocity = self.conditions.velocity
        if velocity is None:
            return None
        end = first_frame + self.facts.horizon
        return velocity.path(first_frame, end, self.root_before(first_frame), self.facts.fps)

    def root_before(self, frame: int) -> RootState:
        """The root's state just before a frame that is held, or the end; without frames, that of the start pose."""
        return root_before(frame, self.timeline, self.guard.reader, self.spec.start_pose, self.facts.fps)


def root_before(frame: int, timeline: Timeline, reader: PoseReader, start: StartPose, fps: int) -> RootState:
    """The root's state just before a frame; it stands at `start` if nothing is held before the frame."""
    begin = max(timeline.first, min(timeline.motion_from, frame - 1), frame - STATE_FRAMES)  # not across a cut
    rows = timeline.rows_between(begin, frame)
    if not len(rows):
        return RootState(start.x, start.z, 0.0, 0.0, start.heading)
    return root_state(reader.positions(rows)[:, [0, 2]], reader.heading(rows[-1]), fps)


def history_crop(spec: SessionSpec, config: EngineConfig) -> int:
    """The most history that a session's windows see."""
    return config.history_crop if spec.history_frames is None else spec.history_frames


def history_frames(frame: int, timeline: Timeline, crop: int, patch: int) -> int:
    """Frames of history of a window that starts at `frame`: whole patches, at most `crop`.

    Fewer than `crop` are held for a while after a session has asked for a longer history.
    """
    return min(crop, (frame - max(timeline.motion_from, timeline.first)) // patch * patch)


def guidance_at(level: Level, asked: Guidance, has_constraints: bool, facts: ModelFacts) -> Guidance:
    """The guidance of a window at a level; if that drops guidance, weights that need fewer evaluations per step.

    Text and constraints that are guided separately cannot both be given in one evaluation; half of each takes two of
    three.
    """
    if not level.drop_guidance:
        return asked
    if facts.guidance_joint:
        return Guidance(1.0, 1.0)
    apart = facts.guidance_passes > 2
    return Guidance(0.5, 0.5) if apart and has_constraints else Guidance(1.0, 0.0)


def steps_at(level: Level, spec: SessionSpec, facts: ModelFacts) -> int:
    """The denoising steps of a window at a level: never more than were asked for."""
    if level.steps is None:
        return spec.denoise_steps
    return min(spec.denoise_steps, max(level.steps, facts.min_steps))
