"""A crowd's script, in real time: which character opens, reports and edits when. It is the engine's inbox.

Events have the times of the script whatever the engine is doing: an event that the engine takes late still carries its
scheduled time. The same seed gives the same script, except for the playheads, which say what each character shows.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from motiongen_server.engine.types import (
    Close,
    Event,
    Float32Array,
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
    Waypoint,
)
from tests.bench.clocks import BenchClock
from tests.bench.playback import Playback

REPORT_EVERY_S = 0.25
OPEN_WITHIN_S = 0.5


@dataclass(frozen=True)
class Habits:
    """What each character does. walkers: one in so many gets waypoints; edits_hz: how often each is edited."""

    num_steps: int = 4
    guidance: float = 2.0
    walkers: int = 4
    edits_hz: float = 0.1
    lookahead: int = 40
    seed: int = 0


class Crowd:
    """Satisfies `motiongen_server.engine.ports.Inbox`; `deliver` takes what the engine sends."""

    def __init__(
        self,
        characters: int,
        habits: Habits,
        embeddings: Sequence[Float32Array],
        model_id: str,
        fps: int,
        clock: BenchClock,
    ) -> None:
        self.playbacks = [Playback(fps) for _ in range(characters)]
        self.num_refused_opens = self.num_told_of_less = 0
        self._habits = habits
        self._embeddings = embeddings
        self._model_id = model_id
        self._clock = clock
        self._random = np.random.default_rng(habits.seed)
        self._seqs = [0] * characters
        self._began_at = clock.now()
        self._order = count()
        self._due: list[tuple[float, int, Callable[[float], Event]]] = []
        self._given: list[Event] = []
        for number in range(characters):
            self._later(self._began_at + OPEN_WITHIN_S * number / characters, self._opens(number))

    # ---- the script -------------------------------------------------------------------------------------------------

    def _later(self, at: float, make: Callable[[float], Event]) -> None:
        heapq.heappush(self._due, (at, next(self._order), make))

    def _opens(self, number: int) -> Callable[[float], Event]:
        """Open a session. Random values are drawn now, so that the script does not depend on arrival order."""
        habits, walks = self._habits, number % self._habits.walkers == 0
        prompt = self._prompt(None)
        gap_s = 1.0 / habits.edits_hz if habits.edits_hz else None
        first_edit_s = 0.0 if gap_s is None else gap_s * (0.2 + 0.8 * float(self._random.random()))
        spec = SessionSpec(
            session=SessionKey(1, number),
            seed=int(self._random.integers(1 << 62)),
            model_id=self._model_id,
            priority=Priority.NEAR,
            lookahead=habits.lookahead,
            denoise_steps=habits.num_steps,
            guidance=Guidance(habits.guidance, habits.guidance),
            prompts=(prompt,),
            constraints=(self._waypoint(30),) if walks else (),
        )

        def make(at: float) -> Event:
            self._later(at + REPORT_EVERY_S, self._reports(number))
            if gap_s is not None:
                self._later(at + first_edit_s, self._edits(number, walks, gap_s))
            return Open(spec, self._next_seq(number), at)

        return make

    def _reports(self, number: int) -> Callable[[float], Event]:
        def make(at: float) -> Event:
            self._later(at + REPORT_EVERY_S, self._reports(number))
            playback = self.playbacks[number]
            frame = playback.frame_at(at)
            return Playhead(SessionKey(1, number), 0, at, frame, playback.buffered_to, playback.underruns())

        return make

    def _edits(self, number: int, walks: bool, gap_s: float) -> Callable[[float], Event]:
        prompt, waypoint = self._prompt(None), self._waypoint(0)

        def make(at: float) -> Event:
            self._later(at + gap_s, self._edits(number, walks, gap_s))
            seq, key = self._next_seq(number), SessionKey(1, number)
            self.playbacks[number].meant(seq, at)
            if not walks:
                return SetPrompts(key, seq, at, upsert=(prompt,))
            frame = self.playbacks[number].frame_at(at) + 40
            target = Waypoint(waypoint.constraint_id, frame, waypoint.x, waypoint.z)
            return SetConstraints(key, seq, at, upsert=(target,), clear=True)

        return make

    def _prompt(self, start_frame: int | None) -> Prompt:
        index = int(self._random.integers(len(self._embeddings)))
        return Prompt(1, start_frame, None, f"prompt {index} {self._random.random()}", self._embeddings[index])

    def _waypoint(self, frame: int) -> Waypoint:
        x, z = self._random.uniform(-1.5, 1.5, 2)
        return Waypoint(1, frame, float(x), float(z))

    def _next_seq(self, number: int) -> int:
        self._seqs[number] += 1
        return self._seqs[number]

    # ---- the engine's inbox -----------------------------------------------------------------------------------------

    def put(self, event: Event) -> bool:
        self._given.append(event)
        return True

    def take_all(self) -> list[Event]:
        """The events scheduled for now or earlier."""
        now = self._clock.now()
        events, self._given = self._given, []
        while self._due and self._due[0][0] <= now:
            at, _, make = heapq.heappop(self._due)
            events.append(make(at))
        return events

    def wait(self, timeout_s: float) -> None:
        until_next_s = self._due[0][0] - self._clock.now() if self._due else timeout_s
        self._clock.sleep(max(0.0, min(timeout_s, until_next_s)))

    def ring(self) -> None:
        """Does nothing: script and engine share a thread, so nothing can be waiting."""

    def leave(self) -> None:
        """End the script: all sessions close at once."""
        now = self._clock.now()
        self._due = []
        self._given += [Close(SessionKey(1, number), 0, now) for number in range(len(self.playbacks))]

    # ---- what the engine sends --------------------------------------------------------------------------------------

    def deliver(self, outputs: Sequence[Output]) -> None:
        now = self._clock.now()
        for output in outputs:
            self.playbacks[output.session.handle].hear(output, now)
            self.num_refused_opens += isinstance(output, Outcome) and output.field == "open"
            self.num_told_of_less += isinstance(output, ServiceLevel) and output.tier is not ServiceTier.FULL
