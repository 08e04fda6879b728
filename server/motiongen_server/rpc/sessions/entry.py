"""SessionEntry: what the edge knows of a session: the order of its events, their answers, what waits, its carrier."""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Protocol

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Closed,
    CloseReason,
    Code,
    ConstraintReached,
    Durable,
    Opened,
    Outcome,
    Output,
    PlanNotice,
    ServiceLevel,
    SessionKey,
    SetOptions,
    Warned,
)
from motiongen_server.models.registry import LoadedModel
from motiongen_server.rpc.budgets.peer import Place
from motiongen_server.rpc.budgets.token_bucket import TokenBucket
from motiongen_server.rpc.convert.frames import PLAIN, FrameCoding
from motiongen_server.rpc.errors.events import invalid_event_seq, sequence_gap
from motiongen_server.rpc.sessions.kept_answers import MAX_KEPT_ANSWERS, PLACEMENT_OBJECT_BYTES, KeptAnswers
from motiongen_server.snapshots.store import Lease

_LEAVING = (CloseReason.DRAINED, CloseReason.TAKEN_OVER)


class Carrier(Protocol):
    """Passes a session's outputs on to its client: the stream that carries the session, or a stand-in without one.

    work: encloses what the event loop does for that client.
    """

    @property
    def work(self) -> AbstractContextManager[None]: ...

    def take(self, *outputs: Output) -> None:
        """Take outputs of sessions, in order."""

    def take_now(self, *outputs: Output) -> None:
        """The same, without waiting for the flush interval."""

    def fail(self, error: Exception) -> None:
        """A fault of the server's own has kept it from taking outputs: end what they were for, and nothing else."""


def session_name(key: SessionKey) -> str:
    """A session's name for the logs; a new one at each call."""
    # Stream and handle find it there; the rest distinguishes it from other servers' sessions, and reused handles.
    return f"{key.stream}-{key.handle}-{secrets.token_hex(6)}"


@dataclass(slots=True, eq=False)
class SessionEntry:
    """What the edge records of one session.

    key: its name in the engine, from the stream on which it was opened. carrier, handle: what carries it now, and its
    handle there. place: among the sessions of its peer. last_seq: the highest event number taken. answered: numbers
    above applied_seq that have been answered already. waiting: events held back behind one whose prompt is being
    encoded, each with its arrival and its texts. known_to_engine: whether its open was passed on. closing: whether its
    close was; is_leaving: it continues elsewhere after that. muted: its frames are dropped, since its client does not
    read. model: what it was opened with. warnings: by event number, for events that have not been answered. token: for
    resuming it, "" while that is not possible. attempt: the last one to resume it; is_resuming: until the engine has
    taken that up; the client is sent nothing meanwhile. opened, level, closed: the last of each kind that the engine
    has sent. answers: outcomes that the client may not have received. asked_options: by event number, options that the
    engine has not answered, and how to tell their place of the answer. coding: of its frames. sent_to: the end of all
    frames ever sent to its client. reached: outcomes of constraints that the client may not have received, oldest
    first, each with sent_to at the time: once the client shows that frame, it has received the outcome. lease: to write
    its record in the store, None if nothing is kept of it; durable: the last report on what is kept. told_epoch: of the
    newest token that the client is known to have.
    """

    key: SessionKey
    model: LoadedModel
    request_id: str
    bucket: TokenBucket
    carrier: Carrier
    handle: int
    place: Place
    last_seq: int = 1
    applied_seq: int = 0
    answered: set[int] = field(default_factory=set)
    waiting: deque[tuple[session_pb2.SessionEvent, float, Sequence[str]]] = field(default_factory=deque)
    waiting_bytes: int = 0  # of the events in waiting
    encoding: asyncio.Task[None] | None = None
    known_to_engine: bool = False
    closing: bool = False
    is_leaving: bool = False
    muted: bool = False
    warnings: dict[int, tuple[Warned, ...]] = field(default_factory=dict)
    token: str = ""
    attempt: int = 0
    is_resuming: bool = False
    opened: Opened | None = None
    level: ServiceLevel | None = None
    closed: Closed | None = None
    answers: KeptAnswers = field(default_factory=KeptAnswers)
    asked_options: dict[int, tuple[SetOptions, Callable[[bool], None]]] = field(default_factory=dict)
    coding: FrameCoding = PLAIN
    sent_to: int = 0
    reached: deque[tuple[ConstraintReached, int]] = field(default_factory=lambda: deque(maxlen=MAX_KEPT_ANSWERS))
    lease: Lease | None = None
    told_epoch: int = 1
    durable: Durable | None = None

    def takes(self, event_seq: int) -> bool:
        """Whether an event is new and next; false for a repetition. Raises EventRefused for a gap, or number 0."""
        if event_seq == 0:
            raise invalid_event_seq(0)
        if event_seq <= self.last_seq:
            return False
        if event_seq != self.last_seq + 1:
            raise sequence_gap(event_seq, self.last_seq + 1)
        self.last_seq = event_seq
        self.note_heard()
        return True

    def note_heard(self) -> None:
        """The client has sent something since the last take-over, so it has the present token; older ones expire."""
        if self.lease is not None and not self.is_resuming:
            self.told_epoch = self.lease.epoch

    def wait_for_prompts(self, event: session_pb2.SessionEvent, received_at: float, texts: Sequence[str]) -> None:
        """Hold an event back until its prompts, and those of the events before it, are encoded."""
        self.waiting.append((event, received_at, texts))
        self._count_waiting(event.ByteSize())

    def take_waiting(self) -> session_pb2.SessionEvent:
        """Remove and return the oldest waiting event."""
        event, *_ = self.waiting.popleft()
        self._count_waiting(-event.ByteSize())
        return event

    def take_all_waiting(self) -> list[session_pb2.SessionEvent]:
        """Remove and return all waiting events, oldest first."""
        return [self.take_waiting() for _ in range(len(self.waiting))]

    def _count_waiting(self, num_bytes: int) -> None:
        self.waiting_bytes += num_bytes
        self.place.peer.waiting_bytes += num_bytes

    @property
    def held_bytes(self) -> int:
        """Roughly the bytes of events that wait, and of what is kept to be sent again."""
        placements = () if self.opened is None else self.opened.placements
        return self.waiting_bytes + self.answers.num_bytes + PLACEMENT_OBJECT_BYTES * len(placements)

    def let_go_of_places(self) -> None:
        """Of what is kept to be sent again, drop placements and warnings, but keep what became of the events."""
        self.answers.let_go_of_places()
        if self.opened is not None:
            self.opened = replace(self.opened, placements=(), warnings=())

    def is_answered(self, event_seq: int) -> bool:
        """Whether an event has been answered."""
        return event_seq <= self.applied_seq or event_seq in self.answered

    # ---- output of the engine ---------------------------------------------------------------------------------------

    def note(self, said: Output) -> Output:
        """Record an output other than frames. Returns it with what the client is told in addition."""
        if isinstance(said, Opened) and self.opened is None:
            warnings, name = self.warnings.pop(1, ()), session_name(self.key)
            said = replace(said, warnings=warnings, session_id=name, session_token=self.token)
            self.opened = said = replace(said, scalar_type=self.coding.scalar_type, outputs=self.coding.outputs)
            self._answer(1)
        elif isinstance(said, Outcome) and said.event_seq:
            warnings = self.warnings.pop(said.event_seq, ()) if self.warnings else ()
            if warnings and said.code is Code.OK:
                said = replace(said, warnings=warnings)
            self._answer(said.event_seq)
            if self.asked_options:
                self._hear_options(said)
            if self.token:
                self.answers.keep(said)
        elif isinstance(said, ConstraintReached) and self.token:
            self.reached.append((said, self.sent_to))
        elif isinstance(said, ServiceLevel):
            self.level = said
        elif isinstance(said, Closed):
            if not self.goes_on_after(said):
                self.applied_seq = self.last_seq
            if said.reason is CloseReason.TAKEN_OVER:  # by another server, where this client shall ask
                message = "another server has taken over the session; resume it there"
                said = replace(said, code=Code.UNAVAILABLE, message=message)
            self.closed = said
        return said

    def _hear_options(self, said: Outcome) -> None:
        """If the engine has answered options, record what holds now, or give back the place that was reserved."""
        options, settle = self.asked_options.pop(said.event_seq, (None, None))
        if options is None or settle is None:
            return
        settle(said.code is Code.OK)
        if said.code is Code.OK and self.opened is not None:
            lookahead, steps = options.lookahead or self.opened.lookahead, options.denoise_steps
            self.opened = replace(
                self.opened, lookahead=lookahead, denoise_steps=self.opened.denoise_steps if steps is None else steps
            )

    def _answer(self, event_seq: int) -> None:
        """Note that an event has been answered, and advance applied_seq past all that have been."""
        if event_seq > self.applied_seq:
            self.answered.add(event_seq)
        while self.applied_seq + 1 in self.answered:
            self.applied_seq += 1
            self.answered.discard(self.applied_seq)

    def goes_on_after(self, closed: Closed) -> bool:
        """Whether the client can resume the session from the store after its end, here or elsewhere.

        Unanswered events are then left unanswered: the client sends them again there. If they were refused, they would
        count as answered, but no record would have them.
        """
        leaves = closed.reason in _LEAVING or closed.code is Code.UNAVAILABLE
        return leaves and self.durable is not None and self.durable.is_kept

    # ---- a client that comes back -----------------------------------------------------------------------------------

    def confirm(self, answered_seq: int) -> None:
        """The client has received the answers to all events up to a number."""
        self.answers.confirm(answered_seq)
        if answered_seq and self.opened is not None and self.opened.placements:  # `opened` answers event 1
            self.opened = replace(self.opened, placements=())

    def note_shown(self, frame: int) -> None:
        """The client shows a frame, and so has received the outcomes of constraints that were sent before it."""
        while self.reached and self.reached[0][1] <= frame:
            self.reached.popleft()

    def welcome_back(self, start_frame: int, notice: PlanNotice | None) -> list[Output]:
        """What a client that resumes is sent first: the session, what it may have missed, and its end if that came.

        start_frame: the next frame that is sent. notice: of the plans it missed, sent before the answers they concern.
        """
        said: list[Output] = [] if self.opened is None else [replace(self.opened, start_frame=start_frame)]
        said += () if notice is None else (notice,)
        said += self.answers
        said += (reached for reached, _ in self.reached)
        return [*said, *(each for each in (self.level, self.durable, self.closed) if each is not None)]
