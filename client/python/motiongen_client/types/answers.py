"""A server's answers about a session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ModelWarning:
    """Says that something was accepted for which the model was not trained, so that the motion may not show it.

    reason: PROMPT_OUTSIDE_DOMAIN, UNTRAINED_CONSTRAINT or UNTRAINED_SPEED; or WARNINGS_LEFT_OUT if the server sent more
    warnings than this client keeps. message: for people; field: its path in the request.
    """

    reason: str
    message: str
    field: str


@dataclass(frozen=True)
class Placement:
    """The frames and place that the server chose for a constraint that left them open.

    arrival_frame: the frame aimed for, between the first and the last at which the constraint may be met. anchor_frame:
    when it takes effect; anchor_x_m, anchor_z_m, anchor_heading_rad: where the character is just before that.
    """

    constraint_id: int
    first_frame: int
    last_frame: int
    arrival_frame: int
    anchor_frame: int
    anchor_x_m: float
    anchor_z_m: float
    anchor_heading_rad: float


@dataclass(frozen=True)
class Opened:
    """What the server chose for a session.

    warnings: about its first prompts and constraints; placements: of those constraints. outputs: name -> width of its
    frames' additional outputs, in order.
    """

    session_id: str
    seed: int
    start_frame: int
    rig_id: str
    model_id: str
    frame_rate_hz: int
    lookahead_frames: int
    committed_horizon_frames: int
    denoise_steps: int
    warnings: tuple[ModelWarning, ...] = ()
    placements: tuple[Placement, ...] = ()
    outputs: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """The answer to an accepted event. effective_frame: the first frame that shows it; None if it alters no frame.

    warnings: about what was accepted but may not come out as asked. placements: of constraints that are `Flexible`.
    """

    event_seq: int
    effective_frame: int | None
    warnings: tuple[ModelWarning, ...] = ()
    placements: tuple[Placement, ...] = ()


@dataclass(frozen=True)
class Reopened:
    """A session that could not be resumed was opened anew, with the last frames as its history.

    frame: the first frame of the new session, in the numbering of the old one. The motion continues from the same pose,
    with the same prompts and constraints, but is not what the lost session would have generated. reason: why, in words.
    """

    frame: int
    reason: str


@dataclass(frozen=True)
class ServiceLevel:
    """How well a session is served. tier: full, fewer_steps, no_guidance or hold; denoise_steps: per window."""

    tier: str
    denoise_steps: int


@dataclass(frozen=True)
class ConstraintReached:
    """What became of a constraint, told once its last frame can no longer change.

    met: whether every error is within its tolerance. position_error_m: the greatest distance, metres;
    rotation_error_rad: the greatest angle between headings or rotations, 0 to pi. None: it constrains nothing of that
    kind.
    """

    constraint_id: int
    met: bool
    frame: int
    position_error_m: float | None
    rotation_error_rad: float | None


@dataclass(frozen=True)
class SessionEnd:
    """How a session ended. frames: how many were sent; late_frames: sent after the playhead had reached them."""

    reason: str
    message: str
    frames: int
    late_frames: int
