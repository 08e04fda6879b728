"""Limits: what the service allows one stream, session and event; told to clients by the catalog and the hello."""

from __future__ import annotations

from dataclasses import dataclass

MAX_COORDINATE_M = 10_000.0
MAX_FRAME = 1 << 53
MAX_GUIDANCE = 10.0
MAX_SPEED_MPS = 10.0
"""Of a SetVelocity; a sprinter's."""
MAX_REQUEST_ID_CHARACTERS = 64


@dataclass(frozen=True, slots=True)
class Limits:
    """Counts, frames and bytes; the meaning of each is that of the field of the same name in the protocol.

    events_per_second, stream_events_per_second: sustained rates of one session and one stream, with bursts of as many.
    max_clip_s: how long one call for a clip may take, whatever deadline it has.
    resume_grace_s: for which a session whose transport was lost can be resumed; 0: it is closed at once.
    soft_backlog_bytes for backlog_s seconds, or hard_backlog_bytes at once, of unsent updates end a stream's sessions.
    """

    max_sessions_per_stream: int = 512
    max_constraints: int = 256
    max_prompts: int = 16
    max_prompt_characters: int = 1_000
    max_request_bytes: int = 1 << 20
    default_lookahead_frames: int = 40
    max_lookahead_frames: int = 80
    max_trajectory_frames: int = 400
    max_hold_frames: int = 400
    max_clip_frames: int = 2_400
    max_clip_samples: int = 16
    max_clip_s: float = 600.0
    events_per_second: float = 50.0
    stream_events_per_second: float = 5_000.0
    soft_backlog_bytes: int = 1 << 20
    hard_backlog_bytes: int = 4 << 20
    backlog_s: float = 5.0
    resume_grace_s: float = 30.0
