"""What engine and runner exchange: a window to denoise, its progress, and its result."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from motiongen_server.engine.types.arrays import Float32Array
from motiongen_server.engine.types.conditions import Constraint
from motiongen_server.engine.types.names import PlanCause, Priority, SessionKey
from motiongen_server.engine.types.owner import NOBODY, Owner
from motiongen_server.engine.types.spec import Guidance, StartPose


@dataclass(frozen=True, slots=True, eq=False)
class WindowJob:
    """One window to denoise: `horizon` frames from first_frame on.

    plan: the session's plan number; with the seed it keys the noise, so that a plan of a session always starts from the
    same noise, whatever else is in the batch. history: (H, D) float32, the normalized features of the H frames before
    first_frame, H a multiple of the patch and often 0; in a session's first window start_pose stands in for it.
    history_tokens: (H / patch, token_width) float32, the tokens that stand for `history`, in the world's frame; None if
    whole tokens of earlier windows do not cover it exactly, and the runner then encodes `history` again. embedding: the
    prompt's, None for no prompt. constraints: absolute frames, only those that reach past first_frame and into the
    window. deadline: when the frames are due; runs_out_at: when the client will have shown all its frames or, without
    any, has waited for them for too long; infinity if nobody plays. cause and priority are for the scheduler and the
    metrics. background: the window of a clip, which nobody plays while it is made. keep_prompt: give the model the
    embedding even if the constraints contradict it. owner: the session's owner.
    """

    job_id: int
    session: SessionKey
    plan: int
    first_frame: int
    history: Float32Array
    start_pose: StartPose | None
    embedding: Float32Array | None
    constraints: tuple[Constraint, ...]
    seed: int
    num_steps: int
    guidance: Guidance
    deadline: float
    priority: Priority
    cause: PlanCause
    created_at: float
    history_tokens: Float32Array | None = None
    background: bool = False
    keep_prompt: bool = False
    owner: Owner = NOBODY
    runs_out_at: float = inf


@dataclass(frozen=True, slots=True)
class RowStatus:
    """One row after a denoising step. finite False: the row holds NaN or infinity and cannot be used any more."""

    job_id: int
    steps_done: int
    finite: bool


@dataclass(frozen=True, slots=True, eq=False)
class WindowResult:
    """A finished window: G frames from the job's first_frame on.

    G is the horizon, or less, but at least a patch, if from the next frame on the model is to be told something else,
    or a goal beyond the window needs room in the next one. frames: (G, row_width) float32, rows for the wire. features:
    (G, D) float32, normalized, for later histories. tokens: (G / patch, token_width) float32, the same frames as
    tokens: normalized, latents on the grid, root in the world's frame; None from a runner that keeps no tokens.
    """

    job_id: int
    frames: Float32Array
    features: Float32Array
    tokens: Float32Array | None = None
