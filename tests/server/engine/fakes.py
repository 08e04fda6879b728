"""A runner and a clock for tests: deterministic numpy, virtual time, no torch.

Every row of a fake window says what it was made from, so that a test can interpret a client's frames. Its root moves
along x, at SPEED metres per second, or as `moves` says. Column FRAME holds the frame's number, PLAN the plan's, PROMPT
the first entry of the prompt's embedding (-1 for none), CONSTRAINTS how many constraints the window saw, SEED the seed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from motiongen_server.engine.types import (
    ChannelBlock,
    ModelFacts,
    PlanCause,
    RigLayout,
    RowStatus,
    WindowJob,
    WindowResult,
)

FRAME, PLAN, PROMPT, CONSTRAINTS, SEED = range(7, 12)
ROW_WIDTH = 12
FEATURE_DIM = 3
TOKEN_WIDTH = 2
SPEED = 0.5

FACTS = ModelFacts(
    model_id="fake",
    rig=RigLayout(
        rig_id="fake",
        joint_names=("root",),
        parents=(-1,),
        neutral_offsets=np.zeros((1, 3), np.float32),
        blocks=(
            ChannelBlock("root_translation_m", 3),
            ChannelBlock("joint_rotation_quat_wxyz", 4),
            ChannelBlock("rest", 5),
        ),
    ),
    fps=20,
    horizon=40,
    patch=4,
    feature_dim=FEATURE_DIM,
    max_window_frames=200,
    min_steps=2,
    max_steps=10,
    default_steps=4,
    embedding_dim=2,
    token_width=TOKEN_WIDTH,
    num_parameters=1234,
    outputs=(ChannelBlock("joint_positions_m", 3), ChannelBlock("joint_velocities_mps", 3)),
)


class FakeClock:
    """Time that passes only when told to. `ticked` is called each time."""

    def __init__(self, start: float = 100.0) -> None:
        self._now = start
        self.ticked: Callable[[], None] = lambda: None

    def now(self) -> float:
        return self._now

    def advance(self, seconds: float) -> None:
        self._now += seconds
        self.ticked()


class RealTime(FakeClock):
    """Time that passes by itself; a fake runner's work adds nothing to it."""

    def now(self) -> float:
        return time.monotonic()

    def advance(self, seconds: float) -> None:
        del seconds


class RunnerFailure(Exception):
    """Raised by a FakeRunner when it was told to fail."""


@dataclass
class FakeRunner:
    """Keeps the runner's contract, and checks that its caller does: breaches are recorded in `breaches`.

    step_s: virtual seconds of a denoising step, by rows. fails: called with "prepare", "denoise" or "decode" and the
    job ids; if it returns True, the call raises. poisoned: whether a job's row turns to NaN in its first step;
    poisoned_result: whether its frames contain NaN. moves: changes the frames of a window in place. holds, rights:
    whether sessions may hold a pose, so that histories lag behind frames, or may be corrected by a fresh start. counts:
    how many frames of a window it returns; None for all.
    """

    clock: FakeClock = field(default_factory=FakeClock)
    step_s: Callable[[int], float] = lambda rows: 0.01
    fails: Callable[[str, Sequence[int]], bool] = lambda call, job_ids: False
    poisoned: Callable[[WindowJob], bool] = lambda job: False
    poisoned_result: Callable[[WindowJob], bool] = lambda job: False
    facts: ModelFacts = FACTS
    jobs: dict[int, WindowJob] = field(default_factory=dict)
    steps: dict[int, int] = field(default_factory=dict)
    batches: list[list[int]] = field(default_factory=list)
    prepared: list[WindowJob] = field(default_factory=list)
    discarded: list[int] = field(default_factory=list)
    decoded: list[int] = field(default_factory=list)
    breaches: list[str] = field(default_factory=list)
    passes: Callable[[WindowJob], int] = lambda job: 1
    moves: Callable[[WindowJob, np.ndarray], None] = lambda job, frames: None
    holds: bool = False
    rights: bool = False
    counts: Callable[[WindowJob], int | None] = lambda job: None

    def num_passes(self, job: WindowJob) -> int:
        return self.passes(job)

    def features(self, rows: np.ndarray) -> np.ndarray:
        self._raise_if_told("features", [])
        return np.repeat(rows[:, FRAME : FRAME + 1], FEATURE_DIM, axis=1)

    def outputs(self, names: Sequence[str], rows: np.ndarray) -> np.ndarray:
        """The outputs of the only joint."""
        self._raise_if_told("outputs", [])
        self._expect(len(rows) >= 2, "outputs of no frame")
        made = {
            "joint_positions_m": rows[1:, :3],
            "joint_velocities_mps": np.diff(rows[:, :3], axis=0) * self.facts.fps,
        }
        return np.concatenate([made[name] for name in names], axis=1)

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        self._raise_if_told("prepare", [job.job_id for job in jobs])
        for job in jobs:
            self._expect(job.job_id not in self.jobs, f"job {job.job_id} prepared twice")
            self._check_job(job)
            self.jobs[job.job_id] = job
            self.steps[job.job_id] = 0
            self.prepared.append(job)

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        self._raise_if_told("denoise", job_ids)
        self.batches.append(list(job_ids))
        self.clock.advance(self.step_s(len(job_ids)))
        self._expect(len(set(job_ids)) == len(job_ids), f"a job twice in batch {job_ids}")
        statuses = []
        for job_id in job_ids:
            self._expect(job_id in self.jobs, f"job {job_id} denoised but not held")
            self.steps[job_id] += 1
            finite = not self.poisoned(self.jobs[job_id])
            statuses.append(RowStatus(job_id, self.steps[job_id], finite))
        return statuses

    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        self._raise_if_told("decode", job_ids)
        results = []
        for job_id in job_ids:
            done, wanted = self.steps[job_id], self.jobs[job_id].num_steps
            self._expect(done == wanted, f"job {job_id} decoded after {done} of {wanted} steps")
            self._expect(job_id not in self.decoded, f"job {job_id} decoded twice")
            self.decoded.append(job_id)
            results.append(self._result(self.jobs.pop(job_id)))
        return results

    def discard(self, job_ids: Sequence[int]) -> None:
        self.discarded += job_ids
        for job_id in job_ids:
            self.jobs.pop(job_id, None)

    def _result(self, job: WindowJob) -> WindowResult:
        horizon = self.facts.horizon
        frames = np.zeros((horizon, ROW_WIDTH), np.float32)
        frames[:, FRAME] = np.arange(job.first_frame, job.first_frame + horizon)
        frames[:, 0] = frames[:, FRAME] * (SPEED / self.facts.fps)
        frames[:, 1:4] = (1.0, 0.0, 1.0)  # a metre above the ground, upright, facing +Z
        frames[:, PLAN] = job.plan
        frames[:, PROMPT] = -1 if job.embedding is None else job.embedding[0]
        frames[:, CONSTRAINTS] = len(job.constraints)
        frames[:, SEED] = job.seed
        if self.poisoned_result(job):
            frames[-1] = np.nan
        features = np.repeat(frames[:, FRAME : FRAME + 1], FEATURE_DIM, axis=1)
        self.moves(job, frames)
        tokens, count = features[:: self.facts.patch, :TOKEN_WIDTH].copy(), self.counts(job)
        return WindowResult(job.job_id, frames[:count], features[:count], tokens)

    def _check_job(self, job: WindowJob) -> None:
        """Check that the history is the frames just before the window, and long enough."""
        length = len(job.history)
        self._expect(length % self.facts.patch == 0, f"history of {length} frames")
        self._expect(length <= self.facts.max_history, f"history of {length} frames")
        self._expect((length == 0) == (job.start_pose is not None), "a start pose beside a history, or neither")
        begins = job.first_frame == 0 or job.cause is PlanCause.CUT
        self._expect(length > 0 or begins or self.rights, f"no history at {job.first_frame}")
        if length:
            last = int(job.history[-1, 0])
            steps = np.diff(job.history[:, 0])
            # a client's own frames before frame 0, and any frames before a cut, have other numbers
            recent = last == job.first_frame - 1 or self.holds or job.first_frame == 0 or job.cause is PlanCause.CUT
            self._expect(recent, f"the history before {job.first_frame} ends at {last}")
            contiguous = bool((steps >= 1).all() if self.holds else (steps == 1).all())
            self._expect(contiguous, f"history before {job.first_frame} is not contiguous")
        if job.history_tokens is not None:
            same = np.array_equal(job.history_tokens[:, 0], job.history[:: self.facts.patch, 0])
            self._expect(same, f"the tokens before {job.first_frame} are not those of the history")

    def _raise_if_told(self, call: str, job_ids: Sequence[int]) -> None:
        if self.fails(call, job_ids):
            raise RunnerFailure(f"{call} of {list(job_ids)}")

    def _expect(self, holds: bool, breach: str) -> None:
        if not holds:
            self.breaches.append(breach)
