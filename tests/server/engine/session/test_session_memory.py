"""A session that is open for an hour, with all that a client can do, is hardly larger at its end than early on."""

import pickle
import random

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.levels import FULL, Level
from motiongen_server.engine.session import emission, events, planning
from motiongen_server.engine.session.opening import Opening, open_session
from motiongen_server.engine.types import (
    Keyframe,
    Playhead,
    Priority,
    Prompt,
    ServiceTier,
    SessionKey,
    SetConstraints,
    SetPrompts,
    SetVelocity,
    Waypoint,
)
from motiongen_server.engine.types.report import StepReport
from tests.server.engine.fakes import FACTS, FakeRunner
from tests.server.engine.stage import prompt, spec

KEY = SessionKey(1, 1)
HOUR_S = 3600.0
TICK_S = 0.2
WINDOW_S = 0.2


class Day:
    """One session and a client that sends events all the time, without the engine."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.runner = FakeRunner(holds=True)
        self.now = 0.0
        self.state = open_session(spec(KEY, priority=Priority.HERO), 0.0, Opening(0, FACTS, EngineConfig(), 0.0))
        self.seq = 1
        self.jobs = 0

    def tick(self) -> None:
        report = StepReport()
        state, now = self.state, self.now
        frame = int(state.clock.estimate(now, state.delivery.sent_to))
        if state.delivery.sent_to and self.random.random() < 0.5:
            rtt_s = self.random.uniform(0.0, 0.3)
            events.apply(state, Playhead(KEY, 0, now, frame, state.delivery.sent_to, 0, rtt_s), now, report)
        if self.random.random() < 0.3:
            self._edit(frame, report)
        if self.random.random() < 0.002:
            state.set_tier(self.random.choice((FULL, FULL, Level(ServiceTier.HOLD, hold=True))))
        emission.emit(state, now, report, lambda names, rows: None)
        if planning.window_due(state, now):
            self.jobs += 1
            self.runner.prepare([planning.next_window(state, now, WINDOW_S, self.jobs)])
        elif state.running is not None and now - state.running.job.created_at >= WINDOW_S:
            job = state.running.job
            for _ in range(job.num_steps):
                self.runner.denoise([job.job_id])
            (result,) = self.runner.decode([job.job_id])
            planning.accept(state, result, now, report)
        self.now += TICK_S

    def _edit(self, frame: int, report: StepReport) -> None:
        self.seq += 1
        ahead = frame + self.random.randrange(10, 300)
        edit: SetPrompts | SetConstraints | SetVelocity
        match self.random.randrange(5):
            case 0:
                edit = SetPrompts(KEY, self.seq, self.now, (prompt(self.seq % 9),))
            case 1:
                late = Prompt(self.seq, ahead, ahead + 20, "", np.array([1, 0], np.float32))
                edit = SetPrompts(KEY, self.seq, self.now, (late,))
            case 2:
                edit = SetConstraints(KEY, self.seq, self.now, (Waypoint(self.seq, ahead, 0.0, 0.0),))
            case 3:
                pose = Keyframe(self.seq, ahead, np.zeros((1, 3), np.float32))
                edit = SetConstraints(KEY, self.seq, self.now, (pose,))
            case _:
                edit = SetVelocity(KEY, self.seq, self.now, self.random.random(), 0.0, None, 50)
        running = self.state.running
        events.apply(self.state, edit, self.now, report)
        if running is not None and self.state.running is None:
            self.runner.discard([running.job.job_id])

    def size(self) -> int:
        return len(pickle.dumps(self.state, protocol=pickle.HIGHEST_PROTOCOL))


def test_session_is_hardly_larger_after_an_hour_than_in_its_first_minutes() -> None:
    day = Day(seed=1)
    sizes: list[int] = []
    while day.now < HOUR_S:
        day.tick()
        if len(sizes) < day.now // 10:
            sizes.append(day.size())
    assert day.state.delivery.sent_to > 0.8 * HOUR_S * FACTS.fps
    early, late = sizes[6:66], sizes[-60:]
    assert sum(late) < 1.25 * sum(early)
    assert max(sizes) < 25_000
    assert day.runner.breaches == []
