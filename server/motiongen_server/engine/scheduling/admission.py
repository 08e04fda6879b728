"""Admission: who may come in, by what sessions ask of the machine and what it has been measured to do.

A session asks for windows at the rate that was seen of its class, edits included, and at the rate at which its client
plays them at the least. That, or the measured load where it is greater, counts. Who has just been let in takes a window
at once besides, so that a rush is let in as fast as those who play can bear. What edits of other owners take beyond
these owners' parts of the machine does not count: it gives way. Clips take what sessions leave, and are only counted.

Threads: `reserve`, `release`, `refusal_of` and `free_share` from any, the rest from the engine's. What is handed out is
no longer changed here.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from math import inf

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.owner_parts import OwnerParts
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.scheduling.window_rates import WindowRates
from motiongen_server.engine.spread import spread_delay_s
from motiongen_server.engine.types import (
    NOBODY,
    Code,
    EventRefused,
    ModelFacts,
    Outcome,
    Owner,
    Priority,
    SessionKey,
    SessionSpec,
)
from motiongen_server.engine.types.refusals import draining, session_limit

# First windows that have not been made count as if they had to be within so long. With them the load may be so many
# times what it may be without: they have no moment at which they must be there, and wait for windows that have. Not
# under a quota: once that is used up, all stand still.
_BEGIN_S = 2.0
_BEYOND_WITH_RUSH = 1.125


class Admission:
    """Holds a place for every session from `reserve` to `release`."""

    def __init__(self, facts: ModelFacts, config: EngineConfig, *, under_quota: bool = False) -> None:
        """under_quota: of processor time, all of which others use too."""
        self._config = config
        self._rates = WindowRates(facts.fps / facts.horizon)
        self._least_steps, self._default_steps = facts.min_steps, facts.default_steps
        self._beyond_with_rush = 1.0 if under_quota else _BEYOND_WITH_RUSH
        self._prices = Prices()
        self._parts = OwnerParts(facts)
        self._edits_hz: Mapping[str, float] = {}
        self._measured = self._elsewhere = 0.0
        self._lock = threading.Lock()
        self._places: dict[SessionKey, SessionSpec] = {}
        self._steps: Counter[Priority] = Counter()
        self._sessions: Counter[Priority] = Counter()
        self._clips = 0
        self._beginning: set[SessionKey] = set()
        self._refusals = 0
        self._refused: Counter[Code] = Counter()
        self._closed_for_good = False

    def close(self) -> None:
        """Let nobody in any more."""
        self._closed_for_good = True

    def set_prices(
        self,
        prices: Prices,
        measured: float,
        elsewhere: float = 0.0,
        rates: WindowRates | None = None,
        edits_hz: Mapping[str, float] | None = None,
    ) -> None:
        """What the machine costs by now, and the share of it that was in use of late: here, and by other engines.

        rates: what sessions of each class ask for by now; edits_hz: windows a second that edits of each owner begin.
        """
        self._prices, self._measured, self._elsewhere = prices, measured, elsewhere
        self._rates = rates or self._rates
        self._edits_hz = self._edits_hz if edits_hz is None else edits_hz

    @property
    def asked(self) -> float:
        """The share of the machine that the sessions ask for, with as many edits as their classes have had of late."""
        return sum(self.asked_by_class.values())

    @property
    def asked_by_class(self) -> dict[Priority, float]:
        """The same, of each class."""
        return {each: self._share(each, self._steps[each], self._sessions[each]) for each in Priority}

    @property
    def _num_sessions(self) -> int:
        return len(self._places) - self._clips

    @property
    def load(self) -> float:
        """The share of the machine that is spoken for, by other engines too."""
        return self._elsewhere + max(self.asked, self._measured)

    @property
    def _rush(self) -> float:
        """The share of the machine that the first windows of those who were just let in take."""
        return len(self._beginning) * self._prices.whole_s(self._default_steps) / _BEGIN_S

    def yielding(self, asks: Owner | None = None) -> float:
        """The share of the machine that edits take beyond the parts of their owners: of all but the one that asks."""
        with self._lock:
            return self._yielding(asks)

    def _yielding(self, asks: Owner | None) -> float:
        return self._parts.yielding(self._prices, self._edits_hz, asks)

    def note_begun(self, session: SessionKey) -> None:
        """A session's first window is there."""
        with self._lock:
            self._beginning.discard(session)

    def _share(self, priority: Priority, steps: int, sessions: int) -> float:
        return self._rates[priority] * self._prices.whole_s(steps, sessions)

    def reserve(self, spec: SessionSpec, event_seq: int) -> Outcome | None:
        """Hold a place for a session, if it has none yet. A refusal where there is no place for it."""
        with self._lock:
            if spec.session in self._places:
                return None
            refusal = self._refusal(spec.priority, spec.denoise_steps, spec.owner, spec.is_clip)
            if refusal is None:
                self._places[spec.session] = spec
                self._count(spec, 1)
                if not spec.is_clip:
                    self._beginning.add(spec.session)
            else:
                self._refused[refusal.code] += 1
            return None if refusal is None else refusal.outcome(spec.session, event_seq)

    def refusal_of(self, priority: Priority, steps: int, *, is_clip: bool = False) -> EventRefused | None:
        """What `reserve` would say to an owner who has none, without holding a place."""
        with self._lock:
            return self._refusal(priority, steps, NOBODY, is_clip)

    def places(self) -> dict[Priority, float]:
        """How many more sessions of each class would be let in, with the default steps, of owners who have none.

        0 where not even one with the fewest. What newcomers take at once is left out, for that soon passes.
        """
        load = self.load - self.yielding(NOBODY) if self._num_sessions else -inf  # who is alone is let in
        return {each: self._places_in(each, self._config.admit_load[each - 1] - load) for each in Priority}

    def _places_in(self, priority: Priority, room: float) -> float:
        """The same in such a share of the machine."""
        least, default = (self._share(priority, steps, 1) for steps in (self._least_steps, self._default_steps))
        if room < least:
            return 0.0
        return room / default if default else inf

    @property
    def num_beginning(self) -> int:
        """Sessions that were let in and have had no window yet."""
        return len(self._beginning)

    @property
    def free_share(self) -> float:
        """Of all that sessions of class NEAR may take, the share that is left to new ones, 0 to 1."""
        if self._closed_for_good:
            return 0.0
        most, sessions = self._config.admit_load[Priority.NEAR - 1], self._config.max_sessions
        return max(0.0, min(1.0 - (self.load + self._rush) / most, 1.0 - self._num_sessions / sessions))

    def release(self, session: SessionKey, spec: SessionSpec | None = None) -> None:
        """Give up a session's place. spec: only if the place is this one's, not that of a later one of the same key."""
        with self._lock:
            held = self._places.get(session)
            if held is not None and (spec is None or held is spec):
                del self._places[session]
                self._beginning.discard(session)
                self._count(held, -1)

    def change(self, spec: SessionSpec, changed: SessionSpec) -> EventRefused | None:
        """Let a session ask for something else. A refusal where it asks for more than there is; it keeps its place."""
        with self._lock:
            before = self._share(spec.priority, spec.denoise_steps, 1)
            more = self._share(changed.priority, changed.denoise_steps, 1) - before
            most = self._config.admit_load[changed.priority - 1]
            load = self.load + more - self._yielding(changed.owner)
            if (more > 0 or changed.priority < spec.priority) and load > most and self._num_sessions > 1:
                return self._full(
                    "OVERLOADED",
                    f"the machine would be {load:.0%} busy; try again later, or ask for less",
                    f"sessions of class {changed.priority.name} up to a load of {most:.0%}",
                    "set_options",
                )
            if self._places.get(spec.session) is spec:
                self._count(spec, -1)
                self._places[spec.session] = changed
                self._count(changed, 1)
            return None

    def _count(self, spec: SessionSpec, change: int) -> None:
        if spec.is_clip:
            self._clips += change
        else:
            self._steps[spec.priority] += change * spec.denoise_steps
            self._sessions[spec.priority] += change
            self._parts.count(spec, change)

    def take_refused(self) -> Counter[Code]:
        """How many were refused since this was last asked, by answer."""
        if not self._refused:
            return Counter()  # not the one that other threads go on counting with, for it is read without the lock
        with self._lock:
            refused, self._refused = self._refused, Counter()
            return refused

    def _refusal(self, priority: Priority, steps: int, owner: Owner, is_clip: bool) -> EventRefused | None:
        config = self._config
        if self._closed_for_good:
            return draining()
        if is_clip:
            if self._clips < config.max_clips:
                return None
            limit = f"at most {config.max_clips} samples of clips at once"
            return self._full("CLIP_LIMIT", "other clips are being made; try again later", limit)
        if self._num_sessions >= config.max_sessions:
            return session_limit(config.max_sessions, self._retry_after_s())
        most = config.admit_load[priority - 1]
        more = self._share(priority, steps, 1) - self._yielding(owner)
        load, beside = self.load + more, self._elsewhere + self.asked + self._rush + more
        is_alone = not self._num_sessions and self._elsewhere <= most
        if is_alone or (load <= most and beside <= self._beyond_with_rush * most):
            return None
        load = max(load, beside)
        return self._full(
            "OVERLOADED",
            f"the machine would be {load:.0%} busy with this session; try again later, or ask for fewer steps",
            f"sessions of class {priority.name} up to a load of {most:.0%}",
        )

    def _full(self, reason: str, message: str, allowed: str, field: str = "open") -> EventRefused:
        return EventRefused(Code.RESOURCE_EXHAUSTED, reason, message, field, allowed, self._retry_after_s())

    def _retry_after_s(self) -> float:
        self._refusals += 1
        return spread_delay_s(self._config.retry_after_s, self._refusals)
