"""Limits: what the service allows for one stream, session, event and peer, and for all together."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

MAX_COORDINATE_M = 10_000.0
MAX_FRAME = 1 << 53
MAX_GUIDANCE = 10.0
MAX_SPEED_MPS = 10.0
"""Of a SetVelocity: a sprinter's speed."""
MAX_REQUEST_ID_CHARACTERS = 64
OTHER_CALLS = 512
"""Calls other than streams and clips, which have settings: catalogues, reflection, and clips that have not begun."""
HEALTH_CALLS = 1024
"""Health checks and watches, which are counted separately."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Counts, frames and bytes; each means the same as the field of that name in the protocol.

    events_per_second, stream_events_per_second: sustained rates of one session and one stream, with bursts of as many.
    max_clip_s: how long one clip call may take, whatever deadline it has.
    resume_grace_s: how long a session can be resumed after its connection is lost; 0: it is closed at once.
    soft_backlog_bytes for backlog_s seconds, or hard_backlog_bytes at once, of unsent updates end a stream's sessions;
    a look-ahead of frames of each open session does not count.
    """

    max_sessions_per_stream: int = 512
    max_constraints: int = 256
    max_prompts: int = 16
    max_prompt_characters: int = 1_000
    max_request_bytes: int = 1 << 20
    default_lookahead_frames: int = 40
    max_lookahead_frames: int = 80
    max_trajectory_frames: int = 400
    max_held_trajectory_frames: int = 24_000
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

    @property
    def max_event_fields(self) -> int:
        """Fields allowed in one event, counted on the wire: enough to set all constraints and prompts at once."""
        return 64 + 16 * (self.max_constraints + self.max_prompts)


@dataclass(frozen=True, slots=True)
class PeerLimits:
    """Limits for everything that one address or tenant has open.

    calls: for catalogues and clips, open at once. events_per_second: tokens, of which an event takes one; see
    `budgets.stream_budget`. prompts_per_second: texts that are not cached. calls_per_second: new streams, clips,
    catalogues. bytes_per_second: received. session_weight: sum of `peer.SESSION_WEIGHTS`; heroes, nears, crowds,
    batches: sessions of each class. clip_samples: under way. share: the peer's weight among others when there is more
    to denoise than time allows; steps_per_second: denoising steps, counted per row. waiting_bytes: events that wait for
    prompts to be encoded, or for the store. held_bytes: unpaid messages, with the parts into which they are split.
    """

    streams: int = 1024
    calls: int = 256
    events_per_second: float = 20_000.0
    prompts_per_second: float = 200.0
    calls_per_second: float = 100.0
    bytes_per_second: float = 16_000_000.0
    session_weight: int = 4096
    heroes: int = 128
    nears: int = 1_000_000
    crowds: int = 1_000_000
    batches: int = 1_000_000
    clip_samples: int = 32
    share: float = 1.0
    steps_per_second: float = inf
    waiting_bytes: int = 16 << 20
    held_bytes: int = 128 << 20


@dataclass(frozen=True, slots=True)
class ServiceLimits:
    """Limits for the service as a whole.

    hello_timeout_s: a stream must send its hello within this time. empty_timeout_s: a stream without sessions is ended
    after this time. stuck_timeout_s: a stream or clip is ended if its client has accepted no data for so long.
    silent_timeout_s: a stream from which nothing comes for so long counts as lost; clients ping every 10 s.
    max_clip_calls: clip calls under way. max_waiting_bytes: unsent updates, answers that clients have not confirmed,
    and received messages that wait, of all streams together. reconnect_after_s: when a server that is going away tells
    clients to connect again; 0: at once. loop_share: the share of the event loop's time that clients' messages may
    take; see `rpc.budgets.loop_time`.
    """

    max_streams: int = 2048
    max_clip_calls: int = 256
    hello_timeout_s: float = 5.0
    empty_timeout_s: float = 300.0
    stuck_timeout_s: float = 30.0
    silent_timeout_s: float = 90.0
    max_waiting_bytes: int = 256 << 20
    reconnect_after_s: float = 0.0
    loop_share: float = 0.4
    peer: PeerLimits = field(default_factory=PeerLimits)
