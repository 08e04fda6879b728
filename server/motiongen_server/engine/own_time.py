"""Measures an engine's own processor time per window before it serves: a simulated crowd on a model that takes no time.

If the model runs on a device other than the processor, the engine's own time is as long as the runner's calls or
longer, so it is the processor that limits how many sessions fit (ADR 96). It must be known before many sessions come at
once, since all of them would be admitted before it could be measured on them.
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
_ROUND_S, _REPORT_EVERY = 0.05, 5  # every 5 rounds, so each client reports its playhead four times a second
_SETTLING = 16  # rounds after the last open, for its first window to be made
_WINDOW_ROUNDS = 8  # a window takes this many rounds at most, so that windows end while time is measured
_MOST_STEPS = 32  # of a window; the time of further steps shows in service, and is little beside the model's


def own_time_s(facts: ModelFacts, config: EngineConfig, processor_s: Callable[[], float] = time.thread_time) -> float:
    """Seconds of processor time that an engine with these settings takes per window, besides the calls of its runner.

    processor_s: the processor time that this thread has used so far. Takes a few tenths of a second.
    """
    clock, screens = _Rounds(), [_Screen() for _ in range(_SESSIONS)]

    def deliver(outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, Chunk):
                screens[output.session.handle].hear(output, clock.now())

    everybody = replace(config, max_sessions=_SESSIONS, admit_load=(inf, inf, inf, inf), degrade=False, snapshots=False)
    engine = Engine(StandingRunner(facts), clock, deliver, everybody)
    windows, used_s, num_steps = 0, 0.0, min(facts.default_steps, _MOST_STEPS)
    opening = ceil(facts.horizon / facts.fps / _ROUND_S)  # for as long as a window plays, so that windows begin evenly
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
    """A clock that shows the time it was set to."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now(self) -> float:
        return self.time_s


@dataclass(slots=True)
class _Screen:
    """What a client shows: the frames it has, starting at begun_at."""

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
