"""EngineConfig: every limit and lead of the engine, checked where it is built."""

from __future__ import annotations

from dataclasses import dataclass

from server.engine.types import ModelFacts, Priority


@dataclass(frozen=True, slots=True)
class EngineConfig:
    """How far ahead, how many, how soon.

    max_sessions, max_rows: sessions held at once; rows of one denoising step.
    max_pending_events, max_prompts, max_constraints: limits of one session.
    history_crop: most history frames given to a window. continue_threshold: unplayed frames at which the next window is
    started; continue_jitter: most frames added to it, different for each session, so that sessions opened together
    spread out. first_chunk, steady_chunk: frames of the first chunk after an edit, and of any chunk at most.
    rtt_s, flush_s, margin_s: the way to the client and back, the service's flush interval, and a safety margin; the sum
    is the least lead of a replan. edit_target_s: seconds from an edit to its frames that each class is promised;
    open_target_s: the same from opening. idle_timeout_s: silence after which a session is closed.
    max_restarts: how often in a row edits may restart a running window before one is allowed to finish.
    initial_step_s: the cost of a denoising step before one has been measured.
    """

    max_sessions: int = 256
    max_rows: int = 32
    max_pending_events: int = 64
    max_prompts: int = 16
    max_constraints: int = 256
    history_crop: int = 16
    continue_threshold: int = 20
    continue_jitter: int = 4
    first_chunk: int = 8
    steady_chunk: int = 20
    rtt_s: float = 0.05
    flush_s: float = 0.02
    margin_s: float = 0.1
    edit_target_s: tuple[float, float, float, float] = (0.05, 0.1, 0.25, 1.0)
    open_target_s: float = 0.5
    idle_timeout_s: float = 300.0
    max_restarts: int = 2
    initial_step_s: float = 0.02

    def __post_init__(self) -> None:
        for name in ("max_sessions", "max_rows", "max_pending_events", "max_prompts", "max_constraints"):
            self._check(name, 1)
        for name in ("first_chunk", "steady_chunk", "continue_threshold"):
            self._check(name, 1)
        for name in ("history_crop", "continue_jitter", "max_restarts", "rtt_s", "flush_s", "margin_s"):
            self._check(name, 0)
        for name in ("open_target_s", "idle_timeout_s", "initial_step_s"):
            self._check(name, 0.001)
        if len(self.edit_target_s) != len(Priority) or min(self.edit_target_s) <= 0:
            raise ValueError(f"edit_target_s is {self.edit_target_s}; give {len(Priority)} positive numbers of seconds")

    def _check(self, name: str, least: float) -> None:
        value = getattr(self, name)
        if not value >= least:
            raise ValueError(f"{name} is {value}; it must be at least {least}")

    def check_against(self, facts: ModelFacts) -> None:
        """Raise ValueError where this configuration and the model cannot work together."""
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

    @property
    def delivery_s(self) -> float:
        """Seconds by which a notice sent now may trail what the client shows."""
        return self.rtt_s + self.flush_s

    @property
    def commit_s(self) -> float:
        """Seconds beyond the playhead that are promised not to change."""
        return self.delivery_s + self.margin_s

    def target_s(self, priority: Priority) -> float:
        return self.edit_target_s[priority - 1]
