"""Runners without speed-ups, as baselines: the formulas of `motiongen_ardy.model.rollout`, rows padded to one length.

`RolloutRunner` computes one window at a time with the functions of `motiongen_ardy.model.rollout`. `PlainRunner` does
the same for many rows at once, which need not have anything in common. Both evaluate every guidance pass, encode each
history again, and decode history and horizon; they share with the served runner only how a job is read and the form of
its frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.config import RELEASED_PATCH
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights, batch_passes, full_passes, guided_prediction
from motiongen_ardy.model.diffusion import cosine_schedule
from motiongen_ardy.model.generation import (
    WindowRequest,
    WindowState,
    denoise_step,
    finish_window,
    start_window,
    world_tokens_of,
)
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.noise import window_noise
from motiongen_ardy.model.rollout import visible_frames
from motiongen_ardy.model.window import Window
from motiongen_server.engine.types import ModelFacts, RowStatus, WindowJob, WindowResult
from motiongen_server.runner.facts import model_facts
from motiongen_server.runner.frames import features_of_rows, wire_rows
from motiongen_server.runner.targets import job_targets


@dataclass(slots=True)
class Row:
    """One job between prepare and decode, its state a batch of one."""

    job: WindowJob
    state: WindowState
    steps_done: int = 0

    @property
    def num_tokens(self) -> int:
        return self.state.window.num_tokens

    @property
    def known_frames(self) -> int:
        return int(self.state.window.history_len + self.state.window.generation_len)


class RolloutRunner:
    """Computes one row per call with `motiongen_ardy.model.rollout`: a `Runner` for schedulers of one window at a time.

    bf16: whether matrix products run in bfloat16.
    """

    def __init__(self, model: Model, model_id: str, default_steps: int = 4, bf16: bool = False) -> None:
        self._model = model
        self._device = model.representation.stats.mean.device
        self._bf16 = bf16
        self._rows: dict[int, Row] = {}
        self._facts = replace(
            model_facts(model, model_id, default_steps), guidance_passes=len(self._passes(GuidanceWeights()))
        )

    @property
    def facts(self) -> ModelFacts:
        return self._facts

    def _passes(self, weights: GuidanceWeights) -> tuple[object, ...]:
        return full_passes(self._model.config.guidance, weights)

    def num_passes(self, job: WindowJob) -> int:
        """As many as the formula has, for every job."""
        del job
        return self._facts.guidance_passes

    def features(self, rows: np.ndarray) -> np.ndarray:
        """Normalised features (H, D) of wire rows (H, row width)."""
        return (
            features_of_rows(self._model.representation, torch.from_numpy(rows).to(self._device)[None])[0].cpu().numpy()
        )

    def outputs(self, names: Sequence[str], rows: np.ndarray) -> np.ndarray:
        """Raises: this runner offers no outputs."""
        raise NotImplementedError(f"no outputs {names} of {len(rows)} rows")

    def _precision(self) -> AbstractContextManager[None]:
        return torch.autocast(self._device.type, torch.bfloat16, enabled=self._bf16)

    @torch.inference_mode()
    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        for job in jobs:
            with self._precision():
                self._rows[job.job_id] = Row(job, start_window(self._model, self._request([job])))

    def _request(self, jobs: Sequence[WindowJob]) -> WindowRequest:
        """The request for jobs that share history length, window length, and whether they have constraints."""
        model, first = self._model, jobs[0]
        history_len = len(first.history)
        num_tokens = model.config.horizon_tokens
        width = model.config.token_width
        targets = [job_targets(model.skeleton, job) for job in jobs]
        span = window_frames(model, first, targets[0])
        goals = [
            goal.observe(model.representation, job.first_frame - history_len, span)
            for job, goal in zip(jobs, targets, strict=True)
            if goal is not None
        ]
        starts = [job.start_pose for job in jobs]
        noise = [window_noise(job.seed, job.plan - 1, num_tokens, width) for job in jobs]
        return WindowRequest(
            num_frames=span,
            num_steps=max(job.num_steps for job in jobs),
            text=torch.stack([self._text(job) for job in jobs]),
            noise=torch.stack(noise).to(self._device),
            weights=GuidanceWeights(first.guidance.text, first.guidance.constraint),
            history=self._stack(job.history for job in jobs) if history_len else None,
            translation=self._stack(np.array([pose.x, 0, pose.z] if pose else [0, 0, 0], "f4") for pose in starts),
            heading=self._stack(np.float32(pose.heading if pose else 0) for pose in starts),
            observed=torch.stack([observed for observed, _ in goals]).to(self._device) if goals else None,
            mask=torch.stack([mask for _, mask in goals]).to(self._device) if goals else None,
        )

    def _stack(self, arrays: Iterable[np.ndarray | np.float32]) -> Tensor:
        return torch.from_numpy(np.stack(list(arrays))).to(self._device)

    def _text(self, job: WindowJob) -> Tensor:
        config = self._model.config.denoiser
        text = torch.zeros(config.text_tokens, config.text_dim, device=self._device)
        if job.embedding is not None:
            vectors = torch.from_numpy(np.atleast_2d(job.embedding)).to(self._device)[: config.text_tokens]
            text[: len(vectors)] = vectors
        return text

    @torch.inference_mode()
    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        statuses = []
        for job_id in job_ids:
            row = self._rows[job_id]
            with self._precision():
                row.state = denoise_step(
                    self._model, row.state, row.job.num_steps - 1 - row.steps_done, row.job.num_steps
                )
            row.steps_done += 1
            statuses.append(RowStatus(job_id, row.steps_done, bool(row.state.tokens.isfinite().all())))
        return statuses

    @torch.inference_mode()
    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        results = []
        for job_id in job_ids:
            row = self._rows[job_id]
            with self._precision():
                features = finish_window(self._model, row.state)[:, len(row.job.history) :].float()
            frames = wire_rows(self._model.representation, features)
            results.append(WindowResult(job_id, frames[0].cpu().numpy(), features[0].cpu().numpy()))
        self.discard(job_ids)
        return results

    def discard(self, job_ids: Sequence[int]) -> None:
        for job_id in job_ids:
            self._rows.pop(job_id, None)


class PlainRunner(RolloutRunner):
    """Computes many rows per call: jobs of one shape are prepared together, rows are padded to the call's longest."""

    @torch.inference_mode()
    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        for members in by_shape(self._model, jobs):
            with self._precision():
                state = start_window(self._model, self._request(members))
            for position, job in enumerate(members):
                self._rows[job.job_id] = Row(job, row_of(state, position))

    @torch.inference_mode()
    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        rows = [self._rows[job_id] for job_id in job_ids]
        num_tokens = max(row.num_tokens for row in rows)
        window = padded_window([row.state.window for row in rows], num_tokens)
        tokens = torch.cat([padded(row.state.tokens, num_tokens) for row in rows])
        num_steps = torch.tensor([row.job.num_steps for row in rows], device=self._device)
        index = num_steps - 1 - torch.tensor([row.steps_done for row in rows], device=self._device)
        schedule = cosine_schedule(self._model.config.num_base_steps).to(self._device)
        weights = [GuidanceWeights(row.job.guidance.text, row.job.guidance.constraint) for row in rows]
        passes = batch_passes([full_passes(self._model.config.guidance, each) for each in weights], self._device)
        with self._precision():
            clean = guided_prediction(
                self._model.denoiser, tokens, schedule.base_step[num_steps, index], window, passes
            )
            moved = schedule.reverse_step(tokens, clean, index, num_steps)
        tokens = torch.where(window.generation_tokens[..., None], moved, tokens)
        statuses = []
        finite = tokens.isfinite().flatten(1).all(1).tolist()
        for position, row in enumerate(rows):
            row.state = replace(row.state, tokens=tokens[position : position + 1, : row.num_tokens])
            row.steps_done += 1
            statuses.append(RowStatus(row.job.job_id, row.steps_done, finite[position]))
        return statuses

    @torch.inference_mode()
    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        rows = [self._rows[job_id] for job_id in job_ids]
        horizon = self._model.config.horizon
        known = [row.known_frames for row in rows]
        num_tokens = max(known) // RELEASED_PATCH
        tokens = torch.cat([padded(row.state.tokens[:, :num_tokens], num_tokens) for row in rows])
        lengths = torch.tensor(known, device=self._device)
        valid = torch.arange(num_tokens * RELEASED_PATCH, device=self._device) < lengths[:, None]
        with self._precision():
            tokens = world_tokens_of(self._model, tokens, torch.cat([row.state.translation for row in rows]))
            features = self._model.codec.from_hybrid(tokens, lengths, valid).float()
        new = torch.stack([features[i, end - horizon : end] for i, end in enumerate(known)])
        frames, new_features = wire_rows(self._model.representation, new).cpu().numpy(), new.cpu().numpy()
        self.discard(job_ids)
        return [WindowResult(job_id, frames[i], new_features[i]) for i, job_id in enumerate(job_ids)]


def window_frames(model: Model, job: WindowJob, targets: Targets | None) -> int:
    """How many frames the job's window has."""
    return visible_frames(model, len(job.history), targets, job.first_frame - len(job.history))


def by_shape(model: Model, jobs: Sequence[WindowJob]) -> list[list[WindowJob]]:
    """Groups of jobs that can be prepared together and have the same guidance."""
    groups: dict[object, list[WindowJob]] = {}
    for job in jobs:
        groups.setdefault((job_shape(model, job), job.guidance), []).append(job)
    return list(groups.values())


def job_shape(model: Model, job: WindowJob) -> tuple[int, int, bool]:
    """What jobs of one plain batch share: history frames, window frames, and whether there are constraints."""
    targets = job_targets(model.skeleton, job)
    return len(job.history), window_frames(model, job, targets), targets is not None


def row_of(state: WindowState, position: int) -> WindowState:
    """One row of a state as a batch of one."""
    one = slice(position, position + 1)
    window = state.window
    return replace(
        state,
        tokens=state.tokens[one],
        translation=state.translation[one],
        window=replace(
            window,
            history_len=window.history_len[one],
            generation_len=window.generation_len[one],
            text=window.text[one],
            heading=window.heading[one],
            observed=None if window.observed is None else window.observed[one],
            mask=None if window.mask is None else window.mask[one],
        ),
    )


def padded(values: Tensor, length: int) -> Tensor:
    """(1, N, C) -> (1, length, C), zeros behind."""
    return functional.pad(values, (0, 0, 0, length - values.shape[1]))


def padded_window(windows: Sequence[Window], num_tokens: int) -> Window:
    """Windows of one row each as a window of many; if any row has constraints, the others get empty ones."""
    num_frames = num_tokens * RELEASED_PATCH
    known = next((window.observed for window in windows if window.observed is not None), None)

    def goals(part: str) -> Tensor | None:
        if known is None:
            return None
        empty = known.new_zeros(1, num_frames, known.shape[-1])
        values = [getattr(window, part) for window in windows]
        return torch.cat([empty if value is None else padded(value, num_frames) for value in values])

    return Window(
        history_len=torch.cat([window.history_len for window in windows]),
        generation_len=torch.cat([window.generation_len for window in windows]),
        num_frames=num_frames,
        text=torch.cat([window.text for window in windows]),
        heading=torch.cat([window.heading for window in windows]),
        observed=goals("observed"),
        mask=goals("mask"),
    )
