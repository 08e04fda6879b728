"""SessionEntry: one session as the edge knows it: whose turn it is, what was answered, what waits, who tells of it."""

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
    """Who tells a client of its session: the stream that carries it, or nobody while there is none.

    work: around what the event loop does for that client.
    """

    @property
    def work(self) -> AbstractContextManager[None]: ...

    def take(self, *outputs: Output) -> None:
        """Take outputs of sessions, in order."""

    def take_now(self, *outputs: Output) -> None:
        """The same, and they do not wait for the flush interval."""

    def fail(self, error: Exception) -> None:
        """A fault of the server's own has kept it from taking outputs: what they were about ends, and nothing else."""


def session_name(key: SessionKey) -> str:
    """A session's name for the logs, another one whenever it is called."""
    # Stream and handle find it there; the rest tells it from sessions of other servers and of a used handle.
    return f"{key.stream}-{key.handle}-{secrets.token_hex(6)}"


@dataclass(slots=True, eq=False)
class SessionEntry:
    """The books of one session.

    key: its name in the engine, of the stream that it was opened on. carrier, handle: who carries it now, and by which
    handle. place: among the sessions of its peer. last_seq: the highest event number taken. answered: numbers above
    applied_seq that have been answered already. waiting: events held back behind one whose prompt is being encoded,
    each with its arrival and its texts. known_to_engine: whether its open was passed on. closing: whether its close
    was; is_leaving: it goes on elsewhere after that. muted: frames for it are dropped, since its client does not read.
    model: what it was opened with. warnings: by event number, of events that have not been answered. token: by which it
    can be resumed, "" while it cannot. attempt: the last one to resume it; is_resuming: until the engine has taken that
    up, and nothing is told. opened, level, closed: the last of each kind that the engine has said. answers: outcomes
    that the client may not have heard. asked_options: by event number, those that the engine has not
    answered, and what their place is to be told then. coding: of its frames. sent_to: the end of those that its client
    was ever sent. reached: what became of constraints that the client may not have heard of, oldest first, each with
    the end of what was sent before: once the client shows a frame from there on it has heard of it. lease: to write its
    record in the store, None where nothing is kept of it; durable: the last said of what is kept. told_epoch: of the
    newest token that the client was seen to have.
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
    waiting_bytes: int = 0  # of them
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
        """Whether an event is new and next; false for a repetition. Raises EventRefused for a gap or no number."""
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
        """Its client has said something of it as it is now, so it has its present token, and needs no older one."""
        if self.lease is not None and not self.is_resuming:
            self.told_epoch = self.lease.epoch

    def wait_for_prompts(self, event: session_pb2.SessionEvent, received_at: float, texts: Sequence[str]) -> None:
        """Hold an event back until its prompts are encoded, and those of the events before it."""
        self.waiting.append((event, received_at, texts))
        self._count_waiting(event.ByteSize())

    def take_waiting(self) -> session_pb2.SessionEvent:
        """The oldest of them, which waits no more."""
        event, *_ = self.waiting.popleft()
        self._count_waiting(-event.ByteSize())
        return event

    def take_all_waiting(self) -> list[session_pb2.SessionEvent]:
        """All of them, oldest first; none waits any more."""
        return [self.take_waiting() for _ in range(len(self.waiting))]

    def _count_waiting(self, num_bytes: int) -> None:
        self.waiting_bytes += num_bytes
        self.place.peer.waiting_bytes += num_bytes

    @property
    def held_bytes(self) -> int:
        """Of events that wait, and of what is kept to be told again, about."""
        placements = () if self.opened is None else self.opened.placements
        return self.waiting_bytes + self.answers.num_bytes + PLACEMENT_OBJECT_BYTES * len(placements)

    def let_go_of_places(self) -> None:
        """Of what is kept to be told again, keep what became of the events, and neither placements nor warnings."""
        self.answers.let_go_of_places()
        if self.opened is not None:
            self.opened = replace(self.opened, placements=(), warnings=())

    def is_answered(self, event_seq: int) -> bool:
        """Whether an event has been answered."""
        return event_seq <= self.applied_seq or event_seq in self.answered

    # ---- what the engine says of it ---------------------------------------------------------------------------------

    def note(self, said: Output) -> Output:
        """Enter anything but frames into the books. Returns it with what is to be told beside it."""
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
            if said.reason is CloseReason.TAKEN_OVER:  # by another server; this client shall ask there
                message = "another server goes on with the session; resume it there"
                said = replace(said, code=Code.UNAVAILABLE, message=message)
            self.closed = said
        return said

    def _hear_options(self, said: Outcome) -> None:
        """The engine may have answered options: keep what the session is now, or give back the place it was to have."""
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
        """Note that an event has been answered, and move applied_seq over all that are."""
        if event_seq > self.applied_seq:
            self.answered.add(event_seq)
        while self.applied_seq + 1 in self.answered:
            self.applied_seq += 1
            self.answered.discard(self.applied_seq)

    def goes_on_after(self, closed: Closed) -> bool:
        """Whether its client takes the session up again from the store, here or elsewhere.

        What has not been answered is then left so: the client says it again there. A refusal would make an event of it
        that was answered, and that no record has.
        """
        leaves = closed.reason in _LEAVING or closed.code is Code.UNAVAILABLE
        return leaves and self.durable is not None and self.durable.is_kept

    # ---- a client that comes back -----------------------------------------------------------------------------------

    def confirm(self, answered_seq: int) -> None:
        """The client has heard the answers to all events up to a number."""
        self.answers.confirm(answered_seq)
        if answered_seq and self.opened is not None and self.opened.placements:  # that answered the first
            self.opened = replace(self.opened, placements=())

    def note_shown(self, frame: int) -> None:
        """The client shows a frame, and so has heard of what became of constraints before that was sent."""
        while self.reached and self.reached[0][1] <= frame:
            self.reached.popleft()

    def welcome_back(self, start_frame: int, notice: PlanNotice | None) -> list[Output]:
        """What a client that resumes is told first: the session, what it may not have heard, and the end if that came.

        start_frame: the next frame that is sent. notice: of the plans it missed, before the answers that they are.
        """
        said: list[Output] = [] if self.opened is None else [replace(self.opened, start_frame=start_frame)]
        said += () if notice is None else (notice,)
        said += self.answers
        said += (reached for reached, _ in self.reached)
        return [*said, *(each for each in (self.level, self.durable, self.closed) if each is not None)]
