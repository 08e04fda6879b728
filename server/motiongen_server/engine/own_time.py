"""What an engine does itself for a window, measured before it serves: a crowd plays, and a model that takes no time.

Where another device than the processor computes, that is as much as calls take, or more, and it is the processor beside
it that says how much (ADR 96). It must be known before many come at once, for all are let in by then.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.standing_runner import StandingRunner
from motiongen_server.engine.types import (
    Chunk,
    ModelFacts,
    Open,
    Output,
    Playhead,
    Priority,
    Prompt,
    SessionKey,
    SessionSpec,
)

_SESSIONS = 192
_ROUND_S, _REPORT_EVERY = 0.05, 5  # rounds; so each client tells its playhead four times a second
_SETTLING = 16  # rounds in which whoever came last has a window made
_WINDOW_ROUNDS = 8  # at most, that a window takes, or nobody would have one while it is measured
_MOST_STEPS = 32  # of a window: what more of them take shows once they are served, and is little beside the model's


def own_time_s(facts: ModelFacts, config: EngineConfig, processor_s: Callable[[], float] = time.thread_time) -> float:
    """Seconds of the processor that an engine with these settings takes for a window, besides calls of its runner.

    processor_s: that this thread has used so far. Takes a few tenths of a second.
    """
    clock, screens = _Rounds(), [_Screen() for _ in range(_SESSIONS)]

    def deliver(outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, Chunk):
                screens[output.session.handle].hear(output, clock.now())

    everybody = replace(config, max_sessions=_SESSIONS, admit_load=(inf, inf, inf, inf), degrade=False, snapshots=False)
    engine = Engine(StandingRunner(facts), clock, deliver, everybody)
    windows, used_s, num_steps = 0, 0.0, min(facts.default_steps, _MOST_STEPS)
    opening = ceil(facts.horizon / facts.fps / _ROUND_S)  # as long as a window plays, so that as many begin each round
    rounds_each = max(1 / _WINDOW_ROUNDS, _SESSIONS / opening / config.max_rows)
    for number in range(2 * opening + _SETTLING):
        now = clock.now()
        for handle, screen in enumerate(screens):
            if handle * opening // _SESSIONS == number:
                engine.submit(Open(_spec(facts, handle, num_steps), 1, now))
            elif screen.end and (number + handle) % _REPORT_EVERY == 0:
                engine.submit(Playhead(SessionKey(0, handle), 0, now, screen.frame(now, facts.fps), screen.end, 0))
        begun_s = processor_s()
        made = sum(len(engine.step().windows) for _ in range(ceil(num_steps * rounds_each)))
        if number >= opening + _SETTLING:
            windows, used_s = windows + made, used_s + processor_s() - begun_s
        clock.time_s += _ROUND_S
    return used_s / max(1, windows)


class _Rounds:
    """A clock that is told the time."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now(self) -> float:
        return self.time_s


@dataclass(slots=True)
class _Screen:
    """What a client shows: frames from begun_at on, as far as it has them."""

    begun_at: float = 0.0
    end: int = 0

    def hear(self, chunk: Chunk, now: float) -> None:
        self.begun_at = self.begun_at if self.end else now
        self.end = chunk.first_frame + len(chunk.rows)

    def frame(self, now: float, fps: float) -> int:
        return min(self.end - 1, int(fps * (now - self.begun_at)))


def _spec(facts: ModelFacts, handle: int, num_steps: int) -> SessionSpec:
    embedding = np.full(facts.embedding_dim, facts.embedding_dim**-0.5, np.float32)
    return SessionSpec(
        session=SessionKey(0, handle),
        seed=handle,
        model_id=facts.model_id,
        priority=Priority.CROWD,
        lookahead=facts.horizon,
        denoise_steps=num_steps,
        guidance=facts.guidance,
        prompts=(Prompt(1, None, None, "stand", embedding),),
    )
