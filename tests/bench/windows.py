"""Characters window after window on a runner, without an engine: what quality is measured on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.types import (
    Constraint,
    Float32Array,
    Guidance,
    PlanCause,
    Priority,
    SessionKey,
    StartPose,
    Waypoint,
    WindowJob,
)
from motiongen_server.runner import TorchRunner

HISTORY_FRAMES = 16


@dataclass(frozen=True)
class Walk:
    """One character: its prompt, its seed, and waypoints (frame, x, z)."""

    seed: int
    embedding: Float32Array
    waypoints: tuple[tuple[int, float, float], ...] = ()

    def constraints_after(self, frame: int) -> tuple[Constraint, ...]:
        return tuple(Waypoint(number, at, x, z) for number, (at, x, z) in enumerate(self.waypoints, 1) if at >= frame)


def generate(
    runner: TorchRunner, walks: Sequence[Walk], num_windows: int, num_steps: int, reuse_tokens: bool = True
) -> Float32Array:
    """Normalised features (B, windows * horizon, D) of all characters, their windows denoised together."""
    horizon, patch = runner.facts.horizon, runner.facts.patch
    features: list[list[Float32Array]] = [[] for _ in walks]
    tokens: list[Float32Array | None] = [None for _ in walks]
    for window in range(num_windows):
        first_frame = window * horizon
        jobs = [
            WindowJob(
                job_id=index,
                session=SessionKey(1, index),
                plan=window + 1,
                first_frame=first_frame,
                history=features[index][-1][-HISTORY_FRAMES:] if window else _none(runner),
                start_pose=None if window else StartPose(0.0, 0.0, 0.0),
                embedding=walk.embedding,
                constraints=walk.constraints_after(first_frame),
                seed=walk.seed,
                num_steps=num_steps,
                guidance=Guidance(1.5, 2.5),
                deadline=0.0,
                priority=Priority.NEAR,
                cause=PlanCause.CONTINUE,
                created_at=0.0,
                history_tokens=_last(tokens[index], HISTORY_FRAMES // patch) if reuse_tokens else None,
            )
            for index, walk in enumerate(walks)
        ]
        ids = [job.job_id for job in jobs]
        runner.prepare(jobs)
        for _ in range(num_steps):
            runner.denoise(ids)
        for result in runner.decode(ids):
            features[result.job_id].append(result.features)
            tokens[result.job_id] = result.tokens
    return np.stack([np.concatenate(parts) for parts in features])


def _none(runner: TorchRunner) -> Float32Array:
    return np.zeros((0, runner.facts.feature_dim), np.float32)


def _last(tokens: Float32Array | None, count: int) -> Float32Array | None:
    return None if tokens is None else tokens[-count:]
