"""ModelLink: the gateway's record of one model on one engine process: its sessions, and what waits to be sent."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from math import inf

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine_port import ModelLost
from motiongen_server.engine.mailbox import Mailbox, pending_refusal
from motiongen_server.engine.ports import Deliver, Observe
from motiongen_server.engine.types import (
    UNTOLD,
    Closed,
    CloseReason,
    Event,
    Open,
    Outcome,
    Output,
    Priority,
    ServiceTier,
    SessionKey,
    StepsOf,
)
from motiongen_server.engine.types.refusals import engine_restarting
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.ledger import RETRY_AFTER_S, Ledger
from motiongen_server.engine_process.messages import TO_GATEWAY, CloseAhead, Events, Pulse, Ready

MAX_PENDING = EngineConfig().max_pending_events


class ModelLink:
    """Lives as long as the model is held, and outlives engine processes.

    `submit` and the properties may be used from any thread; the rest belongs to the engine process's thread.
    """

    def __init__(self, slot: int, source: str, deliver: Deliver, ring: Callable[[], None]) -> None:
        """ring: wakes the engine process's thread. deliver: takes outputs, on that thread."""
        self.slot = slot
        self.source = source
        self.ready: Future[Ready] = Future()
        self.ended = threading.Event()
        self.is_retired = False  # it is being unloaded
        self.is_absent = False  # its engine process has reported that it does not hold it
        self.failure: ModelLost | None = None  # why no engine process is expected to hold it
        self.silent_s = 0.0  # since the engine's last message
        self.observe: Observe | None = None
        self.on_quota_steps: Callable[[StepsOf], None] = lambda taken: None  # steps for owners with a quota
        self.places: Mapping[Priority, float] = {}  # as in `StepReport`, as last reported
        self._deliver = deliver
        self._ring = ring
        self._lock = threading.Lock()
        self._ledger = Ledger()
        self._mailbox = Mailbox(MAX_PENDING)
        self._has_events = False
        self._is_up = False
        self._places_since = 0  # given up less taken, since places were reported
        self._facts = b""
        self._load = self._asked = 0.0
        self._played_before = 0  # sessions that were open when the load was reported
        self.heartbeat_at = time.monotonic()

    # ---- from any thread --------------------------------------------------------------------------------------------

    @property
    def is_up(self) -> bool:
        """Whether its engine takes events."""
        return self._is_up

    @property
    def num_sessions(self) -> int:
        """Sessions and clips that are open, or about to be."""
        return len(self._ledger)

    @property
    def num_clips(self) -> int:
        """How many of `num_sessions` are clips."""
        return self._ledger.num_clips

    @property
    def load(self) -> float:
        """The share of the device that is committed, as last reported, plus what sessions opened since will add."""
        return self._load * self._growth

    @property
    def asked(self) -> float:
        """The share of the device that its sessions are expected to ask for, including those opened since the report.

        Steadier than the load, in which what they used in the last seconds counts if that is more.
        """
        return self._asked * self._growth

    @property
    def _growth(self) -> float:
        """By the number of sessions: clips add no load, nor do sessions that were refused or have ended again."""
        return 1 + self._ledger.num_new / self._played_before if self._played_before else 1.0

    def refuses(self, priority: Priority, steps: int) -> bool:
        """Whether its engine would refuse a session, by its last report and the sessions opened and closed since.

        If it might admit one, it is asked: a session with fewer steps than the default counts as less, one with more
        steps does not count as more.
        """
        size = min(1.0, steps / self.ready.result().facts.default_steps)
        return size > self.places.get(priority, inf) + self._places_since

    def holds(self, session: SessionKey) -> bool:
        """Whether events of the session belong here."""
        return session in self._ledger

    def submit(self, event: Event) -> Outcome | None:
        """Take an event for the engine. Returns a refusal; every other answer is delivered."""
        with self._lock:
            if not self._is_up:
                return refused_without_engine(event)
            if not self._ledger.goes_ahead(event):
                if not self._mailbox.put(event):
                    return pending_refusal(event, MAX_PENDING)
                self._has_events = True
            self._places_since += self._ledger.gives_up_place(event)
            self._places_since -= isinstance(event, Open) and not event.spec.is_clip
            self._ledger.note(event)
        self._ring()
        return None

    def is_of_model(self, other: ModelLink) -> bool:
        """Whether both hold the same model, including its weights; once they are ready."""
        return self._facts == other._facts

    # ---- from the thread of the engine process ----------------------------------------------------------------------

    def take_ready(self, message: Ready) -> bool:
        """The engine takes events from now on. False if it is not the same model as before."""
        facts = TO_GATEWAY.encode(message)
        if self._facts and facts != self._facts:
            return False
        self._facts = facts
        self.failure = None
        self.silent_s = 0.0
        self.heartbeat_at = time.monotonic()
        with self._lock:
            self._is_up = True
        if not self.ready.done():
            self.ready.set_result(message)
        return True

    def take_outputs(self, outputs: Sequence[Output]) -> None:
        """Deliver the engine's outputs."""
        self.silent_s = 0.0
        with self._lock:
            settled = self._ledger.settle(outputs)
        if settled:
            self._deliver(settled)

    def take_pulse(self, pulse: Pulse) -> None:
        """Note that the engine is alive, and what it reports."""
        self.silent_s = 0.0
        self.heartbeat_at = pulse.heartbeat_at
        for report in pulse.reports:
            if report.places is not None:
                with self._lock:  # else an event that is just being counted would bring back the count before it
                    self.places, self._places_since = report.places, 0
            if report.load is not None:
                with self._lock:
                    self._load, self._played_before = report.load, self._ledger.num_played
                    self._ledger.mark()
            if report.asked is not None:
                self._asked = report.asked
            if self.observe is not None:
                self.observe(report)
        taken = tuple(each for report in pulse.reports for each in report.quota_steps)
        if taken:
            self.on_quota_steps(taken)

    def take_events(self) -> Events | None:
        """The events to send next; call it only if there is room for them."""
        if not self._has_events:
            return None
        with self._lock:
            self._has_events = False
            first, events = self._ledger.number(self._mailbox.take_all())
        return Events(self.slot, first, tuple(events)) if events else None

    def take_closes(self) -> list[CloseAhead]:
        """The Closes to send ahead of events."""
        with self._lock:
            closes = self._ledger.take_closes()
        return [CloseAhead(self.slot, close, opened, last) for close, opened, last in closes]

    @property
    def has_events(self) -> bool:
        """Whether events wait to be sent."""
        return self._has_events

    def lose(self, reason: CloseReason, message: str) -> None:
        """The engine is gone: end its sessions, and answer everything unanswered."""
        with self._lock:
            self._is_up = self.is_absent = False
            self._mailbox = Mailbox(MAX_PENDING)
            self._has_events = False
            self._load, self._asked, self._played_before = 0.0, 0.0, 0
            self.places = {}
            outputs = self._ledger.end_all(reason, message)
        if outputs:
            self._deliver(outputs)
        if self.observe is not None:  # the engine's last reports no longer hold
            closes = [output.reason for output in outputs if isinstance(output, Closed)]
            tiers = dict.fromkeys(Priority, ServiceTier.FULL)
            self.observe(StepReport(sessions={}, load=0.0, asked=0.0, tiers=tiers, closes=closes))

    def end(self, error: Exception | None = None) -> None:
        """The model is no longer held. error: why it could not be loaded, if it never was."""
        self.lose(CloseReason.DRAINED, "the server is going away; open a session elsewhere")
        if error is not None and not self.ready.done():
            self.ready.set_exception(error)
        self.ended.set()


def refused_without_engine(event: Event) -> Outcome | None:
    """The answer to an event while its engine process is being started; None for events that get no answer."""
    if isinstance(event, UNTOLD):
        return None
    return engine_restarting(RETRY_AFTER_S).outcome(event.session, event.event_seq)
