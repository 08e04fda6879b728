"""A scenario of `motiongen bench` as an engine's inbox in virtual time, and what its characters show."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from motiongen_server.engine.types import (
    Chunk,
    Close,
    Event,
    Guidance,
    Open,
    Outcome,
    Output,
    Playhead,
    Priority,
    Prompt,
    ServiceLevel,
    ServiceTier,
    SessionKey,
    SessionSpec,
    SetConstraints,
    SetPrompts,
    SetVelocity,
    Waypoint,
)
from motiongen_tools.bench.scenario import EditRule, Scenario
from motiongen_tools.bench.schedule import Schedule
from tests.bench.costed_runner import VirtualClock
from tests.bench.null_runner import FACTS
from tests.bench.playback import Playback

_WAY_S = 0.012  # from a client to the engine, or back: flush and write


@dataclass
class Outcomes:
    """What the characters of a class got. missed_s: seconds without frames, by character."""

    latencies_s: list[float] = field(default_factory=list)
    opens_s: list[float] = field(default_factory=list)
    missed_s: float = 0.0
    refused: int = 0
    degraded: int = 0


class Script:
    """The engine's inbox: its characters' scheduled events and reports. `deliver` takes what the engine sends."""

    def __init__(self, scenario: Scenario, schedule: Schedule, numbers: Sequence[int], clock: VirtualClock) -> None:
        self.clock, self.began_at = clock, clock.now()
        self.outcomes = {priority: Outcomes() for priority in Priority}
        self.playbacks = {number: Playback(FACTS.fps) for number in numbers}
        self._scenario, self._schedule = scenario, schedule
        self._due: list[tuple[float, int, Callable[[float], Event]]] = []
        self._order, self._seqs = count(), dict.fromkeys(numbers, 0)
        self._opened_at: dict[int, float] = {}
        self._given: list[Event] = []
        self.refused: set[int] = set()
        """Characters that were not admitted."""
        for number in numbers:
            plan = schedule.characters[number]
            self._later(plan.open_s, self._opens(number))
            if plan.close_s < math.inf:
                self._later(plan.close_s, self._closes(number))
        for index, number in enumerate(schedule.edit_character):
            if int(number) in self.playbacks:
                self._later(float(schedule.edit_at_s[index]), self._edits(index))

    def priority(self, number: int) -> Priority:
        return Priority[self._scenario.groups[self._schedule.characters[number].group].priority.name]

    def _later(self, at_s: float, make: Callable[[float], Event]) -> None:
        heapq.heappush(self._due, (self.began_at + at_s, next(self._order), make))

    def _seq(self, number: int, at: float) -> int:
        self._seqs[number] += 1
        self.playbacks[number].meant(self._seqs[number], at)
        return self._seqs[number]

    def _opens(self, number: int) -> Callable[[float], Event]:
        plan = self._schedule.characters[number]

        def make(at: float) -> Event:
            key = SessionKey(1, number)
            self._opened_at[number] = at
            self._later(at - self.began_at + 1.0 / self._scenario.report_hz, self._reports(number))
            spec = SessionSpec(
                key, plan.seed, FACTS.model_id, self.priority(number), 40, FACTS.default_steps, Guidance(1.0, 1.0),
                prompts=(_prompt(plan.prompt),),
            )  # fmt: skip
            return Open(spec, 0, at)

        return make

    def _closes(self, number: int) -> Callable[[float], Event]:
        return lambda at: Close(SessionKey(1, number), self._seq(number, at), at)

    def _reports(self, number: int) -> Callable[[float], Event]:
        def make(at: float) -> Event:
            if at - self.began_at < self._schedule.characters[number].close_s:
                self._later(at - self.began_at + 1.0 / self._scenario.report_hz, self._reports(number))
            playback = self.playbacks[number]
            held = playback.buffered_to
            return Playhead(SessionKey(1, number), 0, at, playback.frame_at(at), held, playback.underruns(), 0.01)

        return make

    def _edits(self, index: int) -> Callable[[float], Event]:
        number, value = int(self._schedule.edit_character[index]), int(self._schedule.edit_value[index])
        plan = self._schedule.characters[number]
        rule: EditRule = self._scenario.groups[plan.group].edits[int(self._schedule.edit_rule[index])]

        def make(at: float) -> Event:
            key, seq = SessionKey(1, number), self._seq(number, at)
            if rule.kind == "prompt":
                return SetPrompts(key, seq, at, upsert=(_prompt(value),))
            if rule.kind == "velocity":
                return SetVelocity(key, seq, at, 1.0, 0.1 * (value % 7), None, max(1, int(rule.hold_s * FACTS.fps)))
            first = self.playbacks[number].frame_at(at) + int(rule.ahead_s * FACTS.fps)
            way = [Waypoint(n + 1, first + n * rule.spacing_frames, 0.1 * n, 0.0) for n in range(rule.waypoints)]
            return SetConstraints(key, seq, at, upsert=tuple(way), clear=True)

        return make

    # ---- the engine's inbox -----------------------------------------------------------------------------------------

    def put(self, event: Event) -> bool:
        self._given.append(event)
        return True

    def take_all(self) -> list[Event]:
        """The events that have arrived by now."""
        arrived, self._given = self._given, []
        while self._due and self._due[0][0] + _WAY_S <= self.clock.now():
            at, _, make = heapq.heappop(self._due)
            arrived.append(make(at))
        return arrived

    def wait(self, timeout_s: float) -> None:
        next_at = self._due[0][0] + _WAY_S if self._due else self.clock.now() + timeout_s
        self.clock.time_s += max(1e-6, min(timeout_s, next_at - self.clock.now()))

    def ring(self) -> None:
        """Does nothing: nothing waits on another thread."""

    def deliver(self, outputs: Sequence[Output]) -> None:
        now = self.clock.now() + _WAY_S
        for output in outputs:
            number = output.session.handle
            playback, outcomes = self.playbacks[number], self.outcomes[self.priority(number)]
            had_begun = playback.started_at is not None
            playback.hear(output, now)
            match output:
                case Chunk() if not had_begun:
                    outcomes.opens_s.append(now - self._opened_at[number])
                case Outcome():
                    if output.field == "open":
                        outcomes.refused += 1
                        self.refused.add(number)
                case ServiceLevel():
                    outcomes.degraded += output.tier is not ServiceTier.FULL


def _prompt(number: int) -> Prompt:
    return Prompt(1, None, None, f"prompt {number}", np.full(FACTS.embedding_dim, 1.0 + number, np.float32))
