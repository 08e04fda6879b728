"""What a server says of a session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ModelWarning:
    """What was taken although the model was not trained for it: the motion may not show it.

    reason: PROMPT_OUTSIDE_DOMAIN, UNTRAINED_CONSTRAINT or UNTRAINED_SPEED; message: for people; field: where it was in
    the message.
    """

    reason: str
    message: str
    field: str


@dataclass(frozen=True)
class Placement:
    """Where a constraint was put that left that to the server.

    arrival_frame: the one that is aimed for, between the first and the last at which it may be met. anchor_frame: when
    it takes effect; anchor_x_m, anchor_z_m, anchor_heading_rad: the character just before.
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
    """What the server chose for a session. warnings: of its first prompts and constraints; placements: of these.

    outputs: name -> width of what its frames have besides, in their order.
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
    """The answer to an accepted event. effective_frame: first frame it shows at; None when it alters no frame.

    warnings: of what was taken, but may not come out as asked. placements: of constraints that are `Flexible`.
    """

    event_seq: int
    effective_frame: int | None
    warnings: tuple[ModelWarning, ...] = ()
    placements: tuple[Placement, ...] = ()


@dataclass(frozen=True)
class Reopened:
    """A session that could not be resumed was opened anew, with the last frames as its history.

    frame: the first that the new session made, counted on from those before. The motion goes on from the same pose,
    with the same prompts and constraints, but is not what the lost session would have made. reason: why, in words.
    """

    frame: int
    reason: str


@dataclass(frozen=True)
class ServiceLevel:
    """How well a session is served. tier: full, fewer_steps, no_guidance or hold; denoise_steps: of each window."""

    tier: str
    denoise_steps: int


@dataclass(frozen=True)
class ConstraintReached:
    """What became of a constraint, told when its last frame cannot change any more.

    met: whether every error is within its tolerance. position_error_m: the worst distance, metres; rotation_error_rad:
    the worst angle between headings or rotations, 0 to pi. None: it asks for nothing of that kind.
    """

    constraint_id: int
    met: bool
    frame: int
    position_error_m: float | None
    rotation_error_rad: float | None


@dataclass(frozen=True)
class SessionEnd:
    """How a session ended. frames: sent in all; late_frames: sent after the playhead had reached them."""

    reason: str
    message: str
    frames: int
    late_frames: int
