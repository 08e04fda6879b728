"""New jobs become rows: history tokens, constraints in the window's frame, conditions, noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights, Pass, needed_passes
from motiongen_ardy.model.generation import local_goals, recentre_tokens
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed import PackedDenoiser, RowRequest, WindowVectors
from motiongen_ardy.model.packed.graphs import GraphedRows, GraphRecorder, RowWork
from motiongen_ardy.model.rollout import visible_frames
from motiongen_ardy.model.sampling.plan import plan_window
from motiongen_ardy.model.sampling.projection import RootProjection, free_projection, make_projection
from motiongen_ardy.model.sampling.slowing import motion_before
from motiongen_ardy.model.sampling.window_end import frames_to_keep
from motiongen_ardy.model.tokenizer.explicit import ExplicitBody
from motiongen_ardy.model.tokenizer.model import Tokenizer
from motiongen_server.engine.types import StartPose, WindowJob
from motiongen_server.runner.noise_ahead import NoiseAhead
from motiongen_server.runner.prompts import Prompts, texts_on
from motiongen_server.runner.row import Row
from motiongen_server.runner.targets import job_targets


class _Shape(NamedTuple):
    """What jobs must have in common to be prepared in one go."""

    history_len: int
    num_frames: int
    has_targets: bool


class _Member(NamedTuple):
    """A job with what its window is told. text: (n, W), zeros for no prompt; num_frames: new ones that count."""

    job: WindowJob
    targets: Targets | None
    text: Tensor
    num_frames: int


class Preparation:
    """Prepares jobs of one model. Jobs that share the shape of their window are prepared together."""

    def __init__(
        self,
        model: Model,
        codec: Tokenizer | ExplicitBody,
        denoiser: PackedDenoiser,
        recorder: GraphRecorder | None = None,
    ) -> None:
        """codec: the model's own, as it is served. recorder: of graphs that histories are encoded by."""
        self._model = model
        self._encode: RowWork = lambda features: (codec.to_hybrid(features),)
        self._begin: RowWork = self._begun
        self._prompts = Prompts(model.config.denoiser)
        self._noise = NoiseAhead(model.config.horizon_tokens, model.config.token_width)
        if recorder is not None:
            self._encode = GraphedRows(self._encode, recorder)
            begin = GraphedRows(self._begun, recorder)
            # Rows keep them, and the next replay writes where this one has left them.
            self._begin = lambda *rows: tuple(part.clone() for part in begin(*rows))
        self._denoiser = denoiser
        self._device = model.representation.stats.mean.device

    def passes(self, job: WindowJob) -> tuple[Pass, ...]:
        """The evaluations that one step of this job needs."""
        return needed_passes(
            self._model.sampling.guidance.mode,
            GuidanceWeights(job.guidance.text, job.guidance.constraint),
            has_text=self._prompts.of(job.embedding).is_told,
            has_constraints=bool(job.constraints),
        )

    def rows(self, jobs: Sequence[WindowJob]) -> list[Row]:
        """A row for every job, in any order."""
        groups: dict[_Shape, list[_Member]] = {}
        for job in jobs:
            member = self._member(job)
            history_len = len(job.history)
            num_frames = visible_frames(self._model, history_len, member.targets, job.first_frame - history_len)
            shape = _Shape(history_len, num_frames, member.targets is not None)
            groups.setdefault(shape, []).append(member)
        return [row for shape, members in groups.items() for row in self._group(shape, members)]

    def _member(self, job: WindowJob) -> _Member:
        """The job with its constraints, what leads there from where the character is, and what it is told."""
        options, horizon = self._model.sampling, self._model.config.horizon
        targets = job_targets(self._model.skeleton, job, options.plan.stride_frames if options.plan_root else 1)
        history = torch.from_numpy(job.history) if len(job.history) else None
        pose = job.start_pose
        start = (pose.x, pose.z, pose.heading) if pose else (0.0, 0.0, 0.0)
        kept = frames_to_keep(targets, job.first_frame, horizon, options)
        targets, told = plan_window(
            self._model,
            targets,
            self._prompts.of(job.embedding).text,
            history,
            job.first_frame,
            start,
            keep_text=job.keep_prompt,
        )
        kept = kept if told.led_to is None else min(kept, told.led_to - job.first_frame)
        return _Member(job, targets, told.text, kept)

    def _group(self, shape: _Shape, members: list[_Member]) -> list[Row]:
        members = sorted(members, key=lambda member: member.job.history_tokens is not None)
        jobs = [member.job for member in members]
        texts = texts_on(self._device, [member.text for member in members])
        history, translation, before, *vectors = self._begin(*self._history(shape, jobs), texts)
        observed, mask, goals = None, None, None
        projection = free_projection(before, shape.history_len, self._model.config.horizon, self._model.sampling)
        if shape.has_targets:
            observed, mask = self._goals(shape, members, translation)
            projection = self._projection(shape, members, (observed, mask), before)
            horizon = slice(shape.history_len, shape.history_len + self._model.config.horizon)
            goals = observed[:, horizon], mask[:, horizon]
        led = self._led(projection, len(jobs))
        passes = [self.passes(job) for job in jobs]
        request = RowRequest(WindowVectors(*vectors), observed, mask, passes, projection)
        conditions = self._denoiser.conditions(request)
        noise = torch.stack([self._noise.of(job.seed, job.plan) for job in jobs]).to(self._device)
        if self._device.type == "cuda":  # elsewhere what computes needs the time
            self._noise.follow([(job.seed, job.plan) for job in jobs])
        tensors = zip(noise.unbind(), history.unbind(), translation.unbind(), strict=True)
        return [
            Row(
                member.job,
                tokens,
                before_it,
                moved_by,
                conditions[index],
                member.num_frames,
                None if goals is None else (goals[0][index], goals[1][index]),
                led[index],
            )
            for index, (member, (tokens, before_it, moved_by)) in enumerate(zip(members, tensors, strict=True))
        ]

    def _history(self, shape: _Shape, jobs: Sequence[WindowJob]) -> tuple[Tensor, Tensor]:
        """History tokens (B, N_h, 20 + L) in the world's frame; where they begin, if there are none: (B, 4), the
        origin in metres, and the heading.

        jobs: those whose tokens are known behind the others.
        """
        if shape.history_len == 0:
            poses = [job.start_pose or StartPose() for job in jobs]
            starts = torch.tensor([[pose.x, 0.0, pose.z, pose.heading] for pose in poses], device=self._device)
            return starts.new_zeros(len(jobs), 0, self._model.config.token_width), starts
        known = [job.history_tokens for job in jobs if job.history_tokens is not None]
        unknown = jobs[: len(jobs) - len(known)]
        parts = self._encode(self._stack(job.history for job in unknown)) if unknown else ()
        tokens = torch.cat([*parts, self._stack(known)] if known else parts)  # a copy, which a replay leaves alone
        return tokens, tokens.new_zeros(len(jobs), 4)

    def _begun(self, tokens: Tensor, starts: Tensor, texts: Tensor) -> tuple[Tensor, ...]:
        """What rows begin with: their history (B, N_h, 20 + L) about its end, where that is (B, 3), how the root moved
        (B, 4, as `motion_before`), and what a `WindowVectors` has.

        tokens, starts: as `_history` gives them; texts: (B, n, W).
        """
        layout, history, origin, heading = self._model.representation, tokens, starts[:, :3], starts[:, 3]
        if tokens.shape[1]:
            heading = layout.heading_of_root(tokens[:, 0, :ROOT_WIDTH])
            history, origin = recentre_tokens(self._model, tokens)
        before = motion_before(layout, history, self._model.config.patch)
        return history, origin, before, *self._denoiser.vectors(history, texts, heading)

    def _goals(self, shape: _Shape, members: list[_Member], translation: Tensor) -> tuple[Tensor, Tensor]:
        layout = self._model.representation
        filled = [
            member.targets.fill(layout, member.job.first_frame - shape.history_len, shape.num_frames)
            for member in members
            if member.targets is not None
        ]
        mask = torch.stack([mask for _, mask in filled]).to(self._device)
        observed = layout.normalize(torch.stack([observed for observed, _ in filled]).to(self._device)) * mask
        history_len = torch.full((len(members),), shape.history_len, device=self._device)
        return local_goals(layout, observed, mask, translation, history_len)

    def _projection(
        self, shape: _Shape, members: list[_Member], goals: tuple[Tensor, Tensor], before: Tensor
    ) -> RootProjection | None:
        model, (observed, mask) = self._model, goals
        if not model.sampling.project_root:
            return None
        planned = torch.stack(
            [
                member.targets.planned_frames(member.job.first_frame - shape.history_len, shape.num_frames)
                for member in members
                if member.targets is not None
            ]
        )
        return make_projection(
            model.representation,
            observed,
            mask,
            planned.to(self._device),
            first=shape.history_len,
            num_frames=model.config.horizon,
            options=model.sampling,
            before=before,
        )

    def _led(self, projection: RootProjection | None, num_jobs: int) -> list[bool]:
        """Of each job, whether its root is kept after some steps."""
        options = self._model.sampling.projection
        if projection is None or options.led_steps >= self._model.config.num_base_steps:
            return [False] * num_jobs
        led: list[bool] = projection.leads(options.led_frames).tolist()
        return led

    def _stack(self, arrays: Iterable[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.stack(list(arrays))).to(self._device)
