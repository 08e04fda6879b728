"""The runner: torch and ardy live here. Rows of a batch differ in step, step count, history, goals, guidance, seed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ardy.checkpoint import load_checkpoint
from ardy.config import FRAMES_PER_TOKEN
from ardy.constraint import Targets
from ardy.denoiser.guidance import GuidanceWeights, Pass, batch_passes, guided_prediction, needed_passes
from ardy.diffusion import cosine_schedule
from ardy.model import Model
from ardy.model_card import model_folder, read_model_card
from ardy.noise import window_noise
from ardy.rollout import WindowRequest, start_window, visible_frames, world_tokens_of
from ardy.rotation import matrix_to_quaternion
from ardy.tokenizer.model import ROOT_TOKEN_WIDTH
from ardy.window import Window
from server.engine.types import (
    ChannelBlock,
    JointTargets,
    ModelFacts,
    PoseTarget,
    RigLayout,
    RootPath,
    RootTarget,
    RowStatus,
    WindowJob,
    WindowResult,
)

MIN_STEPS = 2  # one step alone would tell the model that pure noise is almost clean
TOKEN_BUCKETS = (16, 24, 32, 64)


@dataclass(slots=True)
class Row:
    """One job between prepare and decode.

    tokens: (N, 20 + L) on the device. observed, mask: (4N, D) in the window's frame, None without constraints.
    """

    job: WindowJob
    tokens: Tensor
    history_len: int
    translation: Tensor
    heading: Tensor
    text: Tensor
    observed: Tensor | None
    mask: Tensor | None
    passes: tuple[Pass, ...]
    steps_done: int = 0

    @property
    def bucket(self) -> int:
        """The padded number of tokens; rows of one bucket share an evaluation."""
        return next((size for size in TOKEN_BUCKETS if len(self.tokens) <= size), TOKEN_BUCKETS[-1])


class TorchRunner:
    """Runs one model on one device; satisfies `server.engine.ports.Runner`."""

    def __init__(self, model: Model, model_id: str, default_steps: int = 4) -> None:
        self._model = model
        self._tokenizer = model.codec
        self._device = model.representation.stats.mean.device
        self._schedule = cosine_schedule(model.config.num_base_steps).to(self._device)
        self._rows: dict[int, Row] = {}
        self._facts = model_facts(model, model_id, default_steps)

    @property
    def facts(self) -> ModelFacts:
        return self._facts

    def num_passes(self, job: WindowJob) -> int:
        """Evaluations of the denoiser that one step of this job costs."""
        return len(self._passes(job, bool(job.constraints)))

    def _passes(self, job: WindowJob, has_constraints: bool) -> tuple[Pass, ...]:
        return needed_passes(
            self._model.config.guidance,
            GuidanceWeights(job.guidance.text, job.guidance.constraint),
            has_text=job.embedding is not None and bool(np.any(job.embedding)),
            has_constraints=has_constraints,
        )

    @torch.inference_mode()
    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        """Take in new jobs. Those that share history length and window length are encoded together."""
        groups: dict[tuple[int, int, bool], list[tuple[WindowJob, Targets | None]]] = {}
        for job in jobs:
            targets = job_targets(self._model, job)
            span = visible_frames(self._model, len(job.history), targets, job.first_frame - len(job.history))
            groups.setdefault((len(job.history), span, targets is not None), []).append((job, targets))
        prepared: list[Row] = []
        for (history_len, span, _), members in groups.items():
            prepared += self._start(members, history_len, span)
        self._rows.update((row.job.job_id, row) for row in prepared)

    def _start(self, members: list[tuple[WindowJob, Targets | None]], history_len: int, span: int) -> list[Row]:
        jobs = [job for job, _ in members]
        layout, config = self._model.representation, self._model.config
        num_tokens = config.horizon // FRAMES_PER_TOKEN
        width = ROOT_TOKEN_WIDTH + config.denoiser.latent_dim
        goals = [targets.observe(layout, job.first_frame - history_len, span) for job, targets in members if targets]
        starts = [job.start_pose for job in jobs]
        request = WindowRequest(
            num_frames=span,
            num_steps=max(job.num_steps for job in jobs),
            text=torch.stack([self._text(job) for job in jobs]),
            noise=torch.stack([job_noise(job, num_tokens, width) for job in jobs]).to(self._device),
            history=self._stack(job.history for job in jobs) if history_len else None,
            translation=self._stack(
                np.array([pose.x, 0, pose.z] if pose else [0, 0, 0], np.float32) for pose in starts
            ),
            heading=self._stack(np.float32(pose.heading if pose else 0) for pose in starts),
            observed=torch.stack([observed for observed, _ in goals]).to(self._device) if goals else None,
            mask=torch.stack([mask for _, mask in goals]).to(self._device) if goals else None,
        )
        state = start_window(self._model, request)
        return [
            Row(
                job=job,
                tokens=state.tokens[row],
                history_len=history_len,
                translation=state.translation[row],
                heading=state.window.heading[row],
                text=state.window.text[row],
                observed=None if state.window.observed is None else state.window.observed[row],
                mask=None if state.window.mask is None else state.window.mask[row],
                passes=self._passes(job, bool(goals)),
            )
            for row, job in enumerate(jobs)
        ]

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
        """Advance each job by one denoising step; jobs of one token bucket share an evaluation."""
        buckets: dict[tuple[int, bool], list[int]] = {}
        for job_id in job_ids:
            row = self._rows[job_id]
            buckets.setdefault((row.bucket, row.mask is not None), []).append(job_id)
        moved: dict[int, Tensor] = {}
        for ids in buckets.values():
            moved.update(zip(ids, self._step([self._rows[job_id] for job_id in ids]), strict=True))
        statuses = []
        for job_id in job_ids:  # only now, so that a failed evaluation leaves every row where it was
            row = self._rows[job_id]
            row.tokens = moved[job_id]
            row.steps_done += 1
            statuses.append(RowStatus(job_id, row.steps_done, bool(row.tokens.isfinite().all())))
        return statuses

    def _step(self, rows: list[Row]) -> list[Tensor]:
        num_tokens = max(len(row.tokens) for row in rows)
        num_frames = num_tokens * FRAMES_PER_TOKEN
        tokens = torch.stack([functional.pad(row.tokens, (0, 0, 0, num_tokens - len(row.tokens))) for row in rows])
        history_len = torch.tensor([row.history_len for row in rows], device=self._device)
        window = Window(
            history_len=history_len,
            generation_len=torch.full_like(history_len, self._model.config.horizon),
            num_frames=num_frames,
            text=torch.stack([row.text for row in rows]),
            heading=torch.stack([row.heading for row in rows]),
            observed=self._padded([row.observed for row in rows], num_frames),
            mask=self._padded([row.mask for row in rows], num_frames),
        )
        num_steps = torch.tensor([row.job.num_steps for row in rows], device=self._device)
        index = num_steps - 1 - torch.tensor([row.steps_done for row in rows], device=self._device)
        passes = batch_passes([row.passes for row in rows], self._device)
        base_step = self._schedule.base_step[num_steps, index]
        clean = guided_prediction(self._model.denoiser, tokens, base_step, window, passes)
        moved = self._schedule.reverse_step(tokens, clean, index, num_steps)
        result = torch.where(window.generation_tokens[..., None], moved, tokens)
        return [result[position, : len(row.tokens)] for position, row in enumerate(rows)]

    @staticmethod
    def _padded(goals: list[Tensor | None], num_frames: int) -> Tensor | None:
        known = [goal for goal in goals if goal is not None]
        if not known:
            return None
        return torch.stack([functional.pad(goal, (0, 0, 0, num_frames - len(goal))) for goal in known])

    @torch.inference_mode()
    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        """Frames and features of finished jobs, decoded together, padding hidden; the jobs are forgotten."""
        rows = [self._rows[job_id] for job_id in job_ids]
        horizon = self._model.config.horizon
        known = [row.history_len + horizon for row in rows]
        num_tokens = max(known) // FRAMES_PER_TOKEN
        tokens = torch.stack(
            [functional.pad(row.tokens[:num_tokens], (0, 0, 0, max(0, num_tokens - len(row.tokens)))) for row in rows]
        )
        tokens = world_tokens_of(self._model, tokens, torch.stack([row.translation for row in rows]))
        lengths = torch.tensor(known, device=self._device)
        valid = torch.arange(num_tokens * FRAMES_PER_TOKEN, device=self._device) < lengths[:, None]
        features = self._model.codec.from_hybrid(tokens, lengths, valid)
        new = torch.stack([features[i, row.history_len : row.history_len + horizon] for i, row in enumerate(rows)])
        frames = self._frames(new)
        new_features = new.cpu().numpy()
        for job_id in job_ids:
            del self._rows[job_id]
        return [
            WindowResult(job_id, frames[position], new_features[position]) for position, job_id in enumerate(job_ids)
        ]

    def _frames(self, features: Tensor) -> np.ndarray:
        """Wire rows (B, G, row width) of normalised features: root, parent-relative quaternions, contacts."""
        motion = self._model.representation.motion(self._model.representation.denormalize(features))
        quaternions = matrix_to_quaternion(motion.local_rotations)
        # Neighbouring frames keep to one sign of q and -q, so that a client may interpolate the numbers.
        dots = (quaternions[:, 1:] * quaternions[:, :-1]).sum(-1, keepdim=True)
        first = torch.where(quaternions[:, :1, :, :1] < 0, -1.0, 1.0)
        signs = torch.cat([first, torch.where(dots < 0, -1.0, 1.0)], dim=1).cumprod(dim=1)
        parts = [motion.root_positions, (quaternions * signs).flatten(-2), motion.foot_contacts.float()]
        return torch.cat(parts, dim=-1).cpu().numpy()

    def discard(self, job_ids: Sequence[int]) -> None:
        """Forget jobs at any stage."""
        for job_id in job_ids:
            self._rows.pop(job_id, None)


def job_noise(job: WindowJob, num_tokens: int, width: int) -> Tensor:
    """What the job's window starts from. Plans count from 1, a rollout's windows from 0: plan k is window k - 1."""
    return window_noise(job.seed, job.plan - 1, num_tokens, width)


def job_targets(model: Model, job: WindowJob) -> Targets | None:
    """The job's constraints as ardy's targets, None when it has none."""
    if not job.constraints:
        return None
    targets = Targets(model.skeleton)
    for constraint in job.constraints:
        if isinstance(constraint, RootTarget):
            heading = None if constraint.heading is None else torch.tensor([constraint.heading])
            targets.add_root([constraint.frame], torch.tensor([[constraint.x, constraint.z]]), heading)
        elif isinstance(constraint, RootPath):
            frames = range(constraint.first_frame, constraint.last_frame + 1)
            headings = None if constraint.heading is None else torch.from_numpy(constraint.heading)
            targets.add_root(frames, torch.from_numpy(constraint.xz), headings)
        elif isinstance(constraint, JointTargets):
            rotations = None if constraint.rotations is None else torch.from_numpy(constraint.rotations)
            targets.add_joints(constraint.frame, constraint.joints, torch.from_numpy(constraint.positions), rotations)
        elif isinstance(constraint, PoseTarget):
            targets.add_full_body([constraint.frame], torch.from_numpy(constraint.positions)[None])
    return targets


def model_facts(model: Model, model_id: str, default_steps: int) -> ModelFacts:
    """What the engine and the catalog need to know of a model."""
    skeleton, config = model.skeleton, model.config
    offsets = skeleton.offsets.astype(np.float32)
    return ModelFacts(
        model_id=model_id,
        rig=RigLayout(
            rig_id=skeleton.name,
            joint_names=skeleton.joint_names,
            parents=skeleton.parents,
            neutral_offsets=offsets,
            blocks=(
                ChannelBlock("root_translation_m", 3),
                ChannelBlock("joint_rotation_quat_wxyz", 4 * skeleton.num_joints),
                ChannelBlock("foot_contact", 4),
            ),
        ),
        fps=config.fps,
        horizon=config.horizon,
        patch=FRAMES_PER_TOKEN,
        feature_dim=skeleton.feature_dim,
        max_window_frames=config.max_window_frames,
        min_steps=MIN_STEPS,
        max_steps=config.num_base_steps,
        default_steps=default_steps,
        embedding_dim=config.denoiser.text_dim,
        token_width=ROOT_TOKEN_WIDTH + config.denoiser.latent_dim,
        guidance_passes={"separated": 3, "regular": 2, "none": 1}[config.guidance],
    )


def load_runner(model: str, device: str = "cpu", default_steps: int = 4) -> TorchRunner:
    """A runner for a built-in model's name or a checkpoint folder.

    Raises UnknownModel, and CheckpointError, ConfigError or StatsError for a folder that is not a sound checkpoint.
    """
    folder = model_folder(model)
    return TorchRunner(load_checkpoint(folder, device), read_model_card(folder).model_id, default_steps)
