"""Admission: which sessions are admitted, by what sessions ask of the machine and what it was measured to do.

A session counts with the rate of windows seen in its class, edits included, and at least with the rate at which its
client plays them. The sum of these counts, or the measured load if that is higher. A session just admitted also counts
with a window that it needs at once, so that a rush is admitted only as fast as the playing sessions can bear. What
edits of other owners take beyond those owners' parts of the machine does not count, since it gives way. Clips take what
sessions leave, and only their number is limited.

Threads: `reserve`, `release`, `refusal_of` and `free_share` from any, the rest from the engine's. Mappings that were
passed in or returned are never changed here afterwards.
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

# First windows that are not made yet count as if they had to be made within this time. Including them, the load may
# exceed the limit by this factor, as they can wait for windows without which clients run out of frames. Not under a
# quota: once that is used up, everything stands still.
_BEGIN_S = 2.0
_BEYOND_WITH_RUSH = 1.125


class Admission:
    """Holds a place for every session from `reserve` to `release`."""

    def __init__(self, facts: ModelFacts, config: EngineConfig, *, under_quota: bool = False) -> None:
        """under_quota: processor time is limited by a quota, which other processes use too."""
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
        """Admit no more sessions."""
        self._closed_for_good = True

    def set_prices(
        self,
        prices: Prices,
        measured: float,
        elsewhere: float = 0.0,
        rates: WindowRates | None = None,
        edits_hz: Mapping[str, float] | None = None,
    ) -> None:
        """Update what the machine costs, and the share of it that was in use lately: here, and by other engines.

        rates: windows that sessions of each class ask for; edits_hz: windows per second that edits of each owner begin.
        """
        self._prices, self._measured, self._elsewhere = prices, measured, elsewhere
        self._rates = rates or self._rates
        self._edits_hz = self._edits_hz if edits_hz is None else edits_hz

    @property
    def asked(self) -> float:
        """The share of the machine that the sessions ask for, with as many edits as their classes have had lately."""
        return sum(self.asked_by_class.values())

    @property
    def asked_by_class(self) -> dict[Priority, float]:
        """The same by class."""
        return {each: self._share(each, self._steps[each], self._sessions[each]) for each in Priority}

    @property
    def _num_sessions(self) -> int:
        return len(self._places) - self._clips

    @property
    def load(self) -> float:
        """The share of the machine that is in use or spoken for, other engines included."""
        return self._elsewhere + max(self.asked, self._measured)

    @property
    def _rush(self) -> float:
        """The share of the machine that the first windows of just admitted sessions take."""
        return len(self._beginning) * self._prices.whole_s(self._default_steps) / _BEGIN_S

    def yielding(self, asks: Owner | None = None) -> float:
        """The share of the machine that edits take beyond their owners' parts. asks: an owner to leave out."""
        with self._lock:
            return self._yielding(asks)

    def _yielding(self, asks: Owner | None) -> float:
        return self._parts.yielding(self._prices, self._edits_hz, asks)

    def note_begun(self, session: SessionKey) -> None:
        """A session's first window was made."""
        with self._lock:
            self._beginning.discard(session)

    def _share(self, priority: Priority, steps: int, sessions: int) -> float:
        return self._rates[priority] * self._prices.whole_s(steps, sessions)

    def reserve(self, spec: SessionSpec, event_seq: int) -> Outcome | None:
        """Hold a place for a session, if it has none yet. Returns a refusal if there is no place for it."""
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
        """What `reserve` would answer an owner that has no sessions; reserves nothing."""
        with self._lock:
            return self._refusal(priority, steps, NOBODY, is_clip)

    def places(self) -> dict[Priority, float]:
        """How many more sessions of each class would be admitted, with the default steps, from owners that have none.

        0 if not even one with the fewest steps. The first windows of newcomers are left out, as they soon pass.
        """
        load = self.load - self.yielding(NOBODY) if self._num_sessions else -inf  # the first session is always admitted
        return {each: self._places_in(each, self._config.admit_load[each - 1] - load) for each in Priority}

    def _places_in(self, priority: Priority, room: float) -> float:
        """The same, in this share of the machine."""
        least, default = (self._share(priority, steps, 1) for steps in (self._least_steps, self._default_steps))
        if room < least:
            return 0.0
        return room / default if default else inf

    @property
    def num_beginning(self) -> int:
        """Admitted sessions without a first window."""
        return len(self._beginning)

    @property
    def free_share(self) -> float:
        """The share of the capacity for sessions of class NEAR that is left for new ones, 0 to 1."""
        if self._closed_for_good:
            return 0.0
        most, sessions = self._config.admit_load[Priority.NEAR - 1], self._config.max_sessions
        return max(0.0, min(1.0 - (self.load + self._rush) / most, 1.0 - self._num_sessions / sessions))

    def release(self, session: SessionKey, spec: SessionSpec | None = None) -> None:
        """Give up a session's place. spec: only if the place belongs to it, not to a later session of the same key."""
        with self._lock:
            held = self._places.get(session)
            if held is not None and (spec is None or held is spec):
                del self._places[session]
                self._beginning.discard(session)
                self._count(held, -1)

    def change(self, spec: SessionSpec, changed: SessionSpec) -> EventRefused | None:
        """Let a session ask for something else. Returns a refusal, and changes nothing, if that is too much."""
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
        """How many sessions were refused since the last call, by code."""
        if not self._refused:
            return Counter()  # a new one: other threads may be counting with self._refused, read here without the lock
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
