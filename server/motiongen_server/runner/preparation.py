"""Preparation: makes rows of new jobs: history tokens, constraints in the window's frame, conditions, noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights, Pass, needed_passes
from motiongen_ardy.model.generation import local_goals, recentre_tokens
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed import PackedDenoiser, WindowVectors
from motiongen_ardy.model.packed.conditions import RowGoals
from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_ardy.model.packed.graphs import GraphedRows, RowWork, keeping
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


class _Member(NamedTuple):
    """A job with its window's inputs. text: (n, W), zeros for no prompt; num_frames: its new frames that are used.

    length: frames of the window, as far as its constraints require.
    """

    job: WindowJob
    targets: Targets | None
    text: Tensor
    num_frames: int
    length: int


class _Told(NamedTuple):
    """A row's constraints, None without: goals as in `Row`, conditions and projection as in `RowConditions`."""

    goals: tuple[Tensor, Tensor] | None
    conditions: RowGoals | None
    projection: RootProjection | None
    is_led: bool


class Preparation:
    """Prepares jobs of one model, those with equally long histories together."""

    def __init__(
        self,
        model: Model,
        codec: Tokenizer | ExplicitBody,
        denoiser: PackedDenoiser,
        graphs: GraphCache | None = None,
    ) -> None:
        """codec: the model's own, in the form that serves. graphs: the cache from which encoding is replayed."""
        self._model = model
        self._encode: RowWork = lambda features: (codec.to_hybrid(features),)
        self._begin: RowWork = self._begun
        self._prompts = Prompts(model.config.denoiser)
        self._noise = NoiseAhead(model.config.horizon_tokens, model.config.token_width)
        if graphs is not None:
            self._encode = GraphedRows(self._encode, graphs)
            self._begin = keeping(GraphedRows(self._begun, graphs))
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
        groups: dict[int, list[_Member]] = {}
        for job in jobs:
            groups.setdefault(len(job.history), []).append(self._member(job))
        return [row for history_len, members in groups.items() for row in self._group(history_len, members)]

    def _member(self, job: WindowJob) -> _Member:
        """The job with its targets, the lead from the character to them, and the text for its window."""
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
        length = visible_frames(self._model, len(job.history), targets, job.first_frame - len(job.history))
        return _Member(job, targets, told.text, kept, length)

    def _group(self, history_len: int, members: list[_Member]) -> list[Row]:
        """Rows of members whose histories all have history_len frames."""
        # Put like members side by side: those without constraints, and those of equal length.
        members = sorted(members, key=lambda member: (member.targets is not None, member.length))
        jobs = [member.job for member in members]
        texts = texts_on(self._device, [member.text for member in members])
        history, translation, before, *vectors = self._begin(*self._history(history_len, jobs), texts)
        told: list[_Told] = []
        for _, alike in groupby(members, lambda member: (member.targets is not None, member.length)):
            some = list(alike)
            here = slice(len(told), len(told) + len(some))
            told += self._told(history_len, some, translation[here], before[here])
        passes, goals, projections = zip(
            *((self.passes(job), one.conditions, one.projection) for job, one in zip(jobs, told, strict=True)),
            strict=True,
        )
        conditions = self._denoiser.conditions(WindowVectors(*vectors), passes, goals, projections)
        noise = torch.stack([self._noise.of(job.seed, job.plan) for job in jobs]).to(self._device)
        if self._device.type == "cuda":  # otherwise the processor is needed for the computation itself
            self._noise.follow([(job.seed, job.plan) for job in jobs])
        tensors = zip(noise.unbind(), history.unbind(), translation.unbind(), strict=True)
        return [
            Row(member.job, *of_row, of_conditions, member.num_frames, one.goals, one.is_led)
            for member, of_row, of_conditions, one in zip(members, tensors, conditions, told, strict=True)
        ]

    def _told(self, history_len: int, members: list[_Member], translation: Tensor, before: Tensor) -> list[_Told]:
        """The constraints of like members: all without constraints, or all with some and of equal length."""
        model, count = self._model, len(members)
        if members[0].targets is None:
            # On a GPU, asking it which characters move takes longer than projecting those that stand.
            frames, asks = model.config.horizon, self._device.type != "cuda"
            free = free_projection(before, history_len, frames, model.sampling, skips_still=asks)
            return [_Told(None, None, None if free is None else free.rows(row), False) for row in range(count)]
        observed, mask, on_host = self._goals(history_len, members, translation)
        projection = self._projection(history_len, members, (observed, mask), before)
        conditions = self._denoiser.goals(observed, mask, history_len // model.config.patch, on_host)
        horizon = slice(history_len, history_len + model.config.horizon)
        goals = zip(observed[:, horizon].unbind(), mask[:, horizon].unbind(), strict=True)
        return [
            _Told(seen, one, *projected)
            for seen, one, projected in zip(goals, conditions, self._projected(projection, count), strict=True)
        ]

    def _projected(self, projection: RootProjection | None, num_rows: int) -> list[tuple[RootProjection | None, bool]]:
        """For each row, what its root is projected onto, and whether that root is kept after some steps."""
        if projection is None:
            return [(None, False)] * num_rows
        options = self._model.sampling.projection
        is_led = [False] * num_rows
        if options.led_steps < self._model.config.num_base_steps:
            is_led = projection.leads(options.led_frames).tolist()
        return [(projection.rows(row), led) for row, led in enumerate(is_led)]

    def _history(self, history_len: int, jobs: Sequence[WindowJob]) -> tuple[Tensor, Tensor]:
        """History tokens (B, N_h, 20 + L) in the world's frame, and (B, 4) where windows without history begin.

        The latter are the origin in metres and the heading; zeros for windows with history.
        """
        if history_len == 0:
            poses = [job.start_pose or StartPose() for job in jobs]
            starts = torch.tensor([[pose.x, 0.0, pose.z, pose.heading] for pose in poses], device=self._device)
            return starts.new_zeros(len(jobs), 0, self._model.config.token_width), starts
        known = [job.history_tokens for job in jobs if job.history_tokens is not None]
        unknown = [job.history for job in jobs if job.history_tokens is None]
        parts = self._encode(self._stack(unknown)) if unknown else ()
        tokens = torch.cat([*parts, self._stack(known)] if known else parts)  # a copy, which a replay cannot overwrite
        if known and unknown:
            order = sorted(range(len(jobs)), key=lambda number: jobs[number].history_tokens is not None)
            tokens = torch.empty_like(tokens).index_copy_(0, torch.tensor(order, device=self._device), tokens)
        return tokens, tokens.new_zeros(len(jobs), 4)

    def _begun(self, tokens: Tensor, starts: Tensor, texts: Tensor) -> tuple[Tensor, ...]:
        """What rows begin with; texts: (B, n, W); tokens, starts: from `_history`.

        That is their history (B, N_h, 20 + L) relative to its end, the position of that end (B, 3), the root's earlier
        motion (B, 4, as `motion_before`), and the fields of `WindowVectors`.
        """
        layout, history, origin, heading = self._model.representation, tokens, starts[:, :3], starts[:, 3]
        if tokens.shape[1]:
            heading = layout.heading_of_root(tokens[:, 0, :ROOT_WIDTH])
            history, origin = recentre_tokens(self._model, tokens)
        before = motion_before(layout, history, self._model.config.patch)
        return history, origin, before, *self._denoiser.vectors(history, texts, heading)

    def _goals(self, history_len: int, members: list[_Member], translation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Observed features (B, T, D) in the windows' own frames, and their mask, on the device and on the host."""
        layout, num_frames = self._model.representation, members[0].length
        filled = [
            member.targets.fill(layout, member.job.first_frame - history_len, num_frames)
            for member in members
            if member.targets is not None
        ]
        on_host = torch.stack([mask for _, mask in filled])
        on_host[:, :history_len] = 0
        mask = on_host.to(self._device)
        observed = layout.normalize(torch.stack([observed for observed, _ in filled]).to(self._device)) * mask
        lengths = torch.full((len(members),), history_len, device=self._device)
        return *local_goals(layout, observed, mask, translation, lengths), on_host

    def _projection(
        self, history_len: int, members: list[_Member], goals: tuple[Tensor, Tensor], before: Tensor
    ) -> RootProjection | None:
        model, (observed, mask) = self._model, goals
        if not model.sampling.project_root:
            return None
        planned = torch.stack(
            [
                member.targets.planned_frames(member.job.first_frame - history_len, member.length)
                for member in members
                if member.targets is not None
            ]
        )
        return make_projection(
            model.representation,
            observed,
            mask,
            planned.to(self._device),
            first=history_len,
            num_frames=model.config.horizon,
            options=model.sampling,
            before=before,
        )

    def _stack(self, arrays: Iterable[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.stack(list(arrays))).to(self._device)
