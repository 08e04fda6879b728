"""EngineConfig: every limit and lead time of the engine, checked on construction."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.engine.types import ModelFacts, Priority


@dataclass(frozen=True, slots=True)
class EngineConfig:
    """Limits, lead times and rates.

    max_sessions, max_clips: sessions held at once, and clips beside them. max_rows: rows of one denoising step.
    max_step_s: how long a step should take at most, so that an edit need not wait long for the next one; steps are
    never made inefficiently small, though.

    max_pending_events, max_prompts, max_constraints: limits per session. max_held_trajectory_frames: the same for the
    frames of all root trajectories and paths of one session together.

    history_crop: most history frames given to a window. continue_threshold: the next window starts when this many
    frames are left to play. Two numbers spread sessions that were opened together, by different amounts:
    continue_jitter, most frames added to the threshold, and stride_jitter, most frames cut from the first window made
    while the client plays. first_chunk: frames of the first chunk after an edit; steady_chunk: most frames of any
    chunk.

    rtt_s, flush_s, margin_s: round trip to the client, the service's flush interval, and a safety margin; their sum is
    the least lead of a replan. edit_target_s: per class, the promised seconds from an edit to its first frames;
    open_target_s: the same from an open. open_limit_s: a client that has no frames this long after its open counts as
    one that ran out of them, so that nothing less urgent comes before its first window. clip_target_s: a clip's windows
    are due this long after its opening, and precede windows of class BATCH that are due later; clips are made in order
    of arrival.

    idle_timeout_s: a session is closed if no playhead is reported for this long, or none that moves while it plays;
    still_timeout_s: the same for none that moves while it is paused. rewind_s: how long frames behind a session's
    playhead are kept, so that it can be rewound to them.

    max_restarts: how often in a row edits may restart a window that has begun; the one after that finishes. replans_hz:
    per class, most replans a second that edits may cause in a session; edits in between share one. max_waiting_edits:
    edits of one session that may wait for a plan. reuse_tokens: give windows the tokens of earlier windows as history
    where these cover it, rather than encode it again. align_within: a replan that begins within this many frames after
    the previous one begins on the grid of its tokens, up to patch - 1 frames later; 0: never.

    hold_frames: frames of a held pose made at a time. guard_drift: whether to correct characters that are badly posed.
    max_lean_rad: the largest sound mean lean over a window. min_root_height_m, max_root_height_m, max_coordinate_m:
    beyond these root heights, or this far from the origin, a character counts as lost.

    initial_step_s: the cost of a denoising step before one has been measured. playback_rate: how fast a playhead earns
    frames, as a multiple of the frame rate. admit_load: per class, the load up to which sessions are admitted;
    retry_after_s: the least time after which a refused client should ask again. degrade: whether sessions get less than
    they asked for when the machine cannot keep up. snapshots: whether a SnapshotTaken follows every change that a
    session's client could not repeat. trace_as: this engine's name in the timings of windows; empty: no timings are
    given.
    """

    max_sessions: int = 256
    max_clips: int = 64
    max_rows: int = 64
    max_step_s: float = 0.035
    max_pending_events: int = 64
    max_prompts: int = 16
    max_constraints: int = 256
    max_held_trajectory_frames: int = 24_000
    history_crop: int = 16
    continue_threshold: int = 20
    continue_jitter: int = 4
    stride_jitter: int = 20
    first_chunk: int = 8
    steady_chunk: int = 20
    rtt_s: float = 0.05
    flush_s: float = 0.02
    margin_s: float = 0.1
    edit_target_s: tuple[float, float, float, float] = (0.05, 0.1, 0.25, 1.0)
    open_target_s: float = 0.5
    open_limit_s: float = 1.0
    clip_target_s: float = 10.0
    idle_timeout_s: float = 300.0
    rewind_s: float = 0.0
    max_restarts: int = 1
    replans_hz: tuple[float, float, float, float] = (10.0, 5.0, 2.0, 1.0)
    max_waiting_edits: int = 256
    reuse_tokens: bool = True
    align_within: int = 16
    hold_frames: int = 8
    guard_drift: bool = True
    max_lean_rad: float = 1.1
    min_root_height_m: float = -0.5
    max_root_height_m: float = 4.0
    max_coordinate_m: float = 10_000.0
    initial_step_s: float = 0.02
    admit_load: tuple[float, float, float, float] = (0.8874, 0.87, 0.8526, 0.7395)
    retry_after_s: float = 2.0
    degrade: bool = True
    playback_rate: float = 1.05
    still_timeout_s: float = 3600.0
    snapshots: bool = False
    trace_as: str = ""

    def __post_init__(self) -> None:
        for name in ("max_sessions", "max_clips", "max_rows", "max_pending_events", "max_prompts", "max_constraints"):
            self._check(name, 1)
        self._check("max_held_trajectory_frames", 1)
        for name in ("first_chunk", "steady_chunk", "continue_threshold", "max_waiting_edits", "hold_frames"):
            self._check(name, 1)
        for name in (
            "history_crop",
            "align_within",
            "continue_jitter",
            "stride_jitter",
            "max_restarts",
            "rewind_s",
            "rtt_s",
            "flush_s",
            "margin_s",
        ):
            self._check(name, 0)
        for name in (
            "max_step_s",
            "open_target_s",
            "open_limit_s",
            "clip_target_s",
            "idle_timeout_s",
            "initial_step_s",
            "retry_after_s",
            "playback_rate",
            "still_timeout_s",
        ):
            self._check(name, 0.001)
        for name in ("max_lean_rad", "max_coordinate_m"):
            self._check(name, 0.001)
        for name, unit in (("edit_target_s", "seconds"), ("replans_hz", "hertz"), ("admit_load", "load")):
            values = getattr(self, name)
            if len(values) != len(Priority) or min(values) <= 0:
                raise ValueError(f"{name} is {values}; give {len(Priority)} positive numbers ({unit})")
        if not self.min_root_height_m < self.max_root_height_m:
            raise ValueError(
                f"min_root_height_m is {self.min_root_height_m}; it must be below max_root_height_m, "
                f"{self.max_root_height_m}"
            )

    def _check(self, name: str, least: float) -> None:
        value = getattr(self, name)
        if not value >= least:
            raise ValueError(f"{name} is {value}; it must be at least {least}")

    def check_against(self, facts: ModelFacts) -> None:
        """Raise ValueError if this configuration does not fit the model."""
        if self.history_crop % facts.patch or not facts.patch <= self.history_crop <= facts.max_history:
            raise ValueError(
                f"history_crop is {self.history_crop}; {facts.model_id} allows multiples of {facts.patch} "
                f"from {facts.patch} to {facts.max_history}"
            )
        if self.continue_threshold + self.continue_jitter >= facts.horizon:
            raise ValueError(
                f"continue_threshold + continue_jitter is {self.continue_threshold + self.continue_jitter}; "
                f"{facts.model_id} generates {facts.horizon} frames a window, so it must be less"
            )
        if self.stride_jitter >= facts.horizon:
            raise ValueError(f"stride_jitter is {self.stride_jitter}; it must be less than a window's {facts.horizon}")

    @property
    def delivery_s(self) -> float:
        """How long a notice takes to reach the client's screen, in seconds, as long as nothing was measured."""
        return self.rtt_s + self.flush_s

    @property
    def commit_s(self) -> float:
        """How far beyond the playhead frames are committed, in seconds, as long as nothing was measured."""
        return self.delivery_s + self.margin_s

    def target_s(self, priority: Priority) -> float:
        return self.edit_target_s[priority - 1]
