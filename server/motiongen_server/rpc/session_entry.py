"""SessionEntry: one session as its stream knows it: whose turn it is, what was answered, what waits."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass, field, replace

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Code, Opened, Outcome, Output, SessionKey, Warned
from motiongen_server.models.registry import LoadedModel
from motiongen_server.rpc.event_errors import invalid_event_seq, sequence_gap
from motiongen_server.rpc.peers import Place
from motiongen_server.rpc.token_bucket import TokenBucket


@dataclass(slots=True, eq=False)
class SessionEntry:
    """The books of one session on a stream.

    last_seq: the highest event number taken. answered: numbers above applied_seq that have been answered already.
    waiting: events held back behind one whose prompt is being encoded, with the time they came and their texts.
    known_to_engine: whether its open was passed on. closing: whether its close was. muted: frames for it are dropped,
    since its client does not read. model: what it was opened with. place: among the sessions of its peer. warnings: by
    event number, of events that have not been answered.
    """

    key: SessionKey
    model: LoadedModel
    request_id: str
    bucket: TokenBucket
    place: Place
    last_seq: int = 1
    applied_seq: int = 0
    answered: set[int] = field(default_factory=set)
    waiting: deque[tuple[session_pb2.SessionEvent, float, tuple[str, ...]]] = field(default_factory=deque)
    encoding: asyncio.Task[None] | None = None
    known_to_engine: bool = False
    closing: bool = False
    muted: bool = False
    warnings: dict[int, tuple[Warned, ...]] = field(default_factory=dict)

    def takes(self, event_seq: int) -> bool:
        """Whether an event is new and next; false for a repetition. Raises EventRefused for a gap or no number."""
        if event_seq == 0:
            raise invalid_event_seq(0)
        if event_seq <= self.last_seq:
            return False
        if event_seq != self.last_seq + 1:
            raise sequence_gap(event_seq, self.last_seq + 1)
        self.last_seq = event_seq
        return True

    def with_warnings(self, output: Output) -> Output:
        """An output of the session with what is to be told beside it."""
        if self.warnings and isinstance(output, Opened | Outcome):
            warnings = self.warnings.pop(1 if isinstance(output, Opened) else output.event_seq, ())
            if warnings and (isinstance(output, Opened) or output.code is Code.OK):
                return replace(output, warnings=warnings)
        return output

    def answer(self, event_seq: int) -> None:
        """Note that an event has been answered, and move applied_seq over all that are."""
        if event_seq > self.applied_seq:
            self.answered.add(event_seq)
        while self.applied_seq + 1 in self.answered:
            self.applied_seq += 1
            self.answered.discard(self.applied_seq)
