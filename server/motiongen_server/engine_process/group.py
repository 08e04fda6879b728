"""EngineGroup: one model on all engine processes, as one engine. Sessions go to the one with the most free capacity.

Spare engines, for which no cores are left, get sessions only while others are lost.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence

from motiongen_server.engine.spread import spread_delay_s
from motiongen_server.engine.types import Event, EventRefused, ModelFacts, Open, Outcome, Owner, Priority
from motiongen_server.engine.types.refusals import draining, engine_restarting, session_limit
from motiongen_server.engine_process.ledger import RETRY_AFTER_S, no_room
from motiongen_server.engine_process.messages import OwnerChanged
from motiongen_server.engine_process.model_link import ModelLink, refused_without_engine
from motiongen_server.engine_process.process import EngineProcess
from motiongen_server.rpc.abilities import Abilities

Member = tuple[EngineProcess, ModelLink]
STALE_S = 5.0
ASKED_STEPS = 20
"""Engines count as equally asked if they differ by less than one of this many steps; then the number of sessions
decides.
"""


class EngineGroup:
    """The `EnginePort` of a model. A session stays with the engine process that it was opened on."""

    def __init__(
        self,
        members: Sequence[Member],
        max_sessions: int,
        admit_load: float = 1.0,
        num_at_work: int | None = None,
    ) -> None:
        """max_sessions: open on all engine processes together, without clips. admit_load: the load up to which each
        admits sessions. num_at_work: how many of those that are up, from the first on, get sessions; None: all.
        """
        self._members = tuple(members)
        self._num_at_work = num_at_work or len(self._members)
        self._admit_load = admit_load
        self._max_sessions = max_sessions
        self._is_draining = False
        self._refusals = itertools.count()

    @property
    def facts(self) -> ModelFacts:
        """The model's facts, once it is loaded."""
        return self._members[0][1].ready.result().facts

    @property
    def licence(self) -> str:
        """The licence of its weights, once it is loaded."""
        return self._members[0][1].ready.result().licence

    @property
    def abilities(self) -> Abilities:
        """What it was trained for, once it is loaded."""
        return self._members[0][1].ready.result().abilities

    @property
    def num_sessions(self) -> int:
        """Sessions and clips on all engine processes."""
        return sum(link.num_sessions for _, link in self._members)

    @property
    def heartbeat_at(self) -> float:
        """The latest heartbeat of all its engines: one is enough to serve.

        While all are being restarted: old enough for the server not to be ready, too recent for it to be hung.
        """
        beats = [link.heartbeat_at for _, link in self._members if link.is_up]
        return max(beats, default=time.monotonic() - STALE_S)

    @property
    def failure(self) -> BaseException | None:
        """Why no engine process can serve it any more; None if one can."""
        failures = [process.failure or link.failure for process, link in self._members]
        return failures[0] if all(failures) else None

    @property
    def num_engines(self) -> int:
        """Engine processes that serve it at this moment."""
        return sum(link.is_up for _, link in self._members)

    @property
    def load(self) -> float:
        """The share of all devices together that is committed, as their engines see it."""
        return sum(process.load for process, _ in self._members) / self._num_at_work

    @property
    def free_share(self) -> float:
        """As in EnginePort: the mean over engine processes; one that is lost, or admits no NEAR, counts as 0."""
        if self._is_draining:
            return 0.0
        shares = [
            max(0.0, 1.0 - process.load / self._admit_load)
            for process, link in self._at_work
            if link.places.get(Priority.NEAR, 1.0)
        ]
        return max(0.0, min(sum(shares) / self._num_at_work, 1.0 - self._num_played / self._max_sessions))

    @property
    def _at_work(self) -> Sequence[Member]:
        """The members that get sessions at present."""
        return [member for member in self._members if member[1].is_up][: self._num_at_work]

    @property
    def _num_played(self) -> int:
        return sum(link.num_sessions - link.num_clips for _, link in self._members)

    def submit(self, event: Event) -> Outcome | None:
        """Pass an event to its engine. Returns a refusal; every other answer is delivered."""
        link = next((link for _, link in self._members if link.holds(event.session)), None)
        if link is None:
            if isinstance(event, Open):
                return self._open(event)
            # The session has ended meanwhile: any engine can answer that.
            link = next((link for _, link in self._members if link.is_up), None)
        if link is None:
            return refused_without_engine(event)
        return link.submit(event)

    def refusal_of(self, priority: Priority, denoise_steps: int, *, is_clip: bool = False) -> EventRefused | None:
        """Why a session would not be admitted, by what the engines last reported; no place is reserved.

        They are not asked: on a busy machine their answers take long, and asking keeps them from their work.
        """
        links = [link for _, link in self._at_work]
        if self._is_draining:
            return draining()
        if not links:
            return engine_restarting(RETRY_AFTER_S)
        if is_clip:
            return None
        if self._num_played >= self._max_sessions:
            return session_limit(self._max_sessions, self._retry_after_s())
        if not all(link.refuses(priority, denoise_steps) for link in links):
            return None
        return no_room(priority, denoise_steps, self._retry_after_s())

    def _retry_after_s(self) -> float:
        return spread_delay_s(RETRY_AFTER_S, next(self._refusals))

    def _open(self, event: Open) -> Outcome | None:
        spec = event.spec
        refusal = self.refusal_of(spec.priority, spec.denoise_steps, is_clip=spec.is_clip)
        if refusal is not None:
            return refusal.outcome(event.session, event.event_seq)
        free = self._at_work
        if not free:  # one was lost since
            return refused_without_engine(event)

        def taken(member: Member) -> tuple[bool, int, int, int]:
            # An engine refuses by what it has reported; clips are admitted wherever there is a place.
            is_full = not spec.is_clip and member[1].refuses(spec.priority, spec.denoise_steps)
            return is_full, *_taken(*member, spec.is_clip)

        _, link = min(free, key=taken)
        return link.submit(event)

    def note_owner(self, owner: Owner) -> None:
        """Tell the engines what an owner may have from now on, including for its open sessions."""
        for process, link in self._members:
            if link.is_up:  # else it will begin without any sessions of the owner
                process.tell(OwnerChanged(link.slot, owner))

    def drain(self) -> None:
        """Admit no new sessions; open ones continue."""
        self._is_draining = True

    def stop(self) -> None:
        """Finish the running windows, close every session as DRAINED, and unload the model."""
        self._is_draining = True
        for process, link in self._members:
            process.unload_model(link)

    def join(self, timeout_s: float | None = None) -> bool:
        """Wait until it is unloaded everywhere. True if it is."""
        ends_at = None if timeout_s is None else time.monotonic() + timeout_s
        for _, link in self._members:
            link.ended.wait(None if ends_at is None else max(0.0, ends_at - time.monotonic()))
        return all(link.ended.is_set() for _, link in self._members)


def _taken(process: EngineProcess, link: ModelLink, by_clips: bool) -> tuple[int, int, int]:
    """How occupied an engine process is. Clips do not count towards `asked`: they use what sessions leave."""
    num_clips = link.num_clips if by_clips else 0
    return num_clips, round(ASKED_STEPS * process.asked), process.num_sessions
