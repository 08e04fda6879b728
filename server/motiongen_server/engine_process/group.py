"""EngineGroup: one model on all engine processes, as one engine. Sessions go to the one with the most room.

Of these that have cores of their own, that is; the others stand in for those that are lost.
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
"""What is asked of engines that differs by less than one of so many steps is held to be equal: then the number of
sessions decides.
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
        """max_sessions: open on all engine processes together, clips left out. admit_load: of each, up to which they
        let sessions in. num_at_work: as many of those that are up, the first ones, are given sessions; None: all.
        """
        self._members = tuple(members)
        self._num_at_work = num_at_work or len(self._members)
        self._admit_load = admit_load
        self._max_sessions = max_sessions
        self._is_draining = False
        self._refusals = itertools.count()

    @property
    def facts(self) -> ModelFacts:
        """Of the model; once it is loaded."""
        return self._members[0][1].ready.result().facts

    @property
    def licence(self) -> str:
        """Of its weights; once it is loaded."""
        return self._members[0][1].ready.result().licence

    @property
    def abilities(self) -> Abilities:
        """What it was trained for; once it is loaded."""
        return self._members[0][1].ready.result().abilities

    @property
    def num_sessions(self) -> int:
        """Sessions and clips on all engine processes."""
        return sum(link.num_sessions for _, link in self._members)

    @property
    def heartbeat_at(self) -> float:
        """When the engine that is best off last went round: one is enough to serve.

        While all are started anew: too long ago to be ready, too lately for the server to be hung.
        """
        beats = [link.heartbeat_at for _, link in self._members if link.is_up]
        return max(beats, default=time.monotonic() - STALE_S)

    @property
    def failure(self) -> BaseException | None:
        """Why no engine process is left to serve it."""
        failures = [process.failure for process, _ in self._members]
        return failures[0] if all(failures) else None

    @property
    def load(self) -> float:
        """The share of all devices together that is spoken for, as their engines see it."""
        return sum(process.load for process, _ in self._members) / self._num_at_work

    @property
    def free_share(self) -> float:
        """As in EnginePort: the mean over engine processes; one that is lost, or lets no NEAR in, has nothing left."""
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
        """Those that sessions are given to by now."""
        return [member for member in self._members if member[1].is_up][: self._num_at_work]

    @property
    def _num_played(self) -> int:
        return sum(link.num_sessions - link.num_clips for _, link in self._members)

    def submit(self, event: Event) -> Outcome | None:
        """Hand in an event. What is returned is a refusal; every other answer is delivered."""
        link = next((link for _, link in self._members if link.holds(event.session)), None)
        if link is None:
            if isinstance(event, Open):
                return self._open(event)
            # Of a session that has ended meanwhile: any engine knows what to answer.
            link = next((link for _, link in self._members if link.is_up), None)
        if link is None:
            return refused_without_engine(event)
        return link.submit(event)

    def refusal_of(self, priority: Priority, denoise_steps: int, *, is_clip: bool = False) -> EventRefused | None:
        """Why a session would not be let in, by what engines have last told; no place is held.

        They are not asked: on a busy machine their answer takes long, and asking keeps them from their work.
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
            # What an engine has told of is what it would refuse by; clips are let in wherever there is a place.
            is_full = not spec.is_clip and member[1].refuses(spec.priority, spec.denoise_steps)
            return is_full, *_taken(*member, spec.is_clip)

        _, link = min(free, key=taken)
        return link.submit(event)

    def note_owner(self, owner: Owner) -> None:
        """An owner may have this from now on, with the sessions that it has."""
        for process, link in self._members:
            if link.is_up:  # else it begins with none of its sessions
                process.tell(OwnerChanged(link.slot, owner))

    def drain(self) -> None:
        """Take no new sessions; those that are open are served on."""
        self._is_draining = True

    def stop(self) -> None:
        """Finish the windows that run, close every session as DRAINED, and forget the model."""
        self._is_draining = True
        for process, link in self._members:
            process.unload_model(link)

    def join(self, timeout_s: float | None = None) -> bool:
        """Wait for the end. True if it has come."""
        ends_at = None if timeout_s is None else time.monotonic() + timeout_s
        for _, link in self._members:
            link.ended.wait(None if ends_at is None else max(0.0, ends_at - time.monotonic()))
        return all(link.ended.is_set() for _, link in self._members)


def _taken(process: EngineProcess, link: ModelLink, by_clips: bool) -> tuple[int, int, int]:
    """How little room an engine process has. Clips are not asked for: they take what sessions leave."""
    num_clips = link.num_clips if by_clips else 0
    return num_clips, round(ASKED_STEPS * process.asked), process.num_sessions
