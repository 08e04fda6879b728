"""Ledger: what the gateway knows of each session in an engine process, so that every event gets an answer."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from motiongen_server.engine.types import (
    Chunk,
    Close,
    Closed,
    CloseReason,
    Code,
    Event,
    EventRefused,
    Open,
    Opened,
    Outcome,
    Output,
    Playhead,
    Priority,
    SessionKey,
)
from motiongen_server.engine.types.refusals import engine_restarting, session_closed

RETRY_AFTER_S = 2.0


@dataclass(slots=True)
class Entry:
    """One session, from its submitted Open to the Closed that came back.

    unanswered: event_seqs without an Outcome, oldest first. unsent: those of them that still wait to be sent.
    held_back: those that are not sent because the session is closing. opened, last: the numbers, as sent to the engine,
    of its Open and its last event; 0 until they are sent. close: its Close, once submitted, which is sent ahead.
    """

    open_seq: int
    unanswered: dict[int, None] = field(default_factory=dict)
    unsent: set[int] = field(default_factory=set)
    held_back: list[int] = field(default_factory=list)
    opened: int = 0
    last: int = 0
    close: Close | None = None
    is_open: bool = False
    num_frames: int = 0
    is_clip: bool = False


@dataclass(slots=True)
class Late:
    """Answers that the engine will still give for a session that it refused or ended; all were already given here.

    seqs: of events that were sent. close_seq: that of its Close, 0 if none was sent. After the answer to the Close no
    more will come, since the engine drops the events that the Close has overtaken.
    """

    seqs: set[int]
    close_seq: int


class Ledger:
    """The sessions of one model on an engine process. Not thread-safe: its owner holds a lock."""

    def __init__(self) -> None:
        self._entries: dict[SessionKey, Entry] = {}
        self._closing: dict[SessionKey, Close] = {}
        self._answered: set[tuple[SessionKey, int]] = set()  # answered here before they were sent
        self._late: dict[SessionKey, deque[Late]] = {}  # sessions of the same key, in the engine's order
        self._number = 0
        self.num_clips = 0
        self._new: set[SessionKey] = set()  # opened since `mark`, and still open

    def __contains__(self, session: SessionKey) -> bool:
        """Whether a session is open, or about to be."""
        return session in self._entries

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def num_played(self) -> int:
        """Sessions that are open, or about to be, without clips."""
        return len(self._entries) - self.num_clips

    @property
    def num_new(self) -> int:
        """How many of `num_played` were opened since `mark`."""
        return len(self._new)

    def mark(self) -> None:
        """Count sessions as new that are opened from now on."""
        self._new.clear()

    # ---- on the way to the engine -----------------------------------------------------------------------------------

    def note(self, event: Event) -> None:
        """Note an accepted event. Events of sessions that are unknown here are answered by the engine."""
        entry = self._entries.get(event.session)
        if entry is None:
            if isinstance(event, Open):
                is_clip = event.spec.is_clip
                self._entries[event.session] = Entry(event.event_seq, {event.event_seq: None}, is_clip=is_clip)
                self.num_clips += is_clip
                if not is_clip:
                    self._new.add(event.session)
        elif isinstance(event, Close):
            entry.close = event
            self._closing[event.session] = event
        elif not isinstance(event, Playhead) and event.event_seq:
            entry.unanswered[event.event_seq] = None
            entry.unsent.add(event.event_seq)

    def goes_ahead(self, event: Event) -> bool:
        """Whether an event is a Close of a known session, which overtakes waiting events."""
        return isinstance(event, Close) and event.session in self._entries

    def gives_up_place(self, event: Event) -> bool:
        """Whether an event, before it is noted, is the first Close of a session that takes the place of another."""
        entry = self._entries.get(event.session) if isinstance(event, Close) else None
        return entry is not None and not entry.is_clip and entry.close is None

    def number(self, events: Iterable[Event]) -> tuple[int, list[Event]]:
        """The number of the first of these events, and those that are to be sent.

        For a session that is closing only the Open is sent; the rest is answered with its Closed.
        """
        sent: list[Event] = []
        first = self._number + 1
        for event in events:
            entry = self._entries.get(event.session)
            if (event.session, event.event_seq) in self._answered:
                self._answered.remove((event.session, event.event_seq))
                continue
            # An event before the session's Open belongs to an earlier session of the same key, such as a late Playhead.
            if entry is not None and (entry.opened or isinstance(event, Open)):
                entry.unsent.discard(event.event_seq)
                if entry.close is not None and entry.opened:
                    if event.event_seq in entry.unanswered:
                        entry.held_back.append(event.event_seq)
                    continue
                if not entry.opened:
                    entry.opened = self._number + 1
                entry.last = self._number + 1
            self._number += 1
            sent.append(event)
        return first, sent

    def take_closes(self) -> list[tuple[Close, int, int]]:
        """Remove and return the Closes that can be sent, each with the numbers of its session's Open and last event."""
        ready = [key for key in self._closing if self._entries[key].opened]
        return [(self._closing.pop(key), self._entries[key].opened, self._entries[key].last) for key in ready]

    # ---- on the way back --------------------------------------------------------------------------------------------

    def settle(self, outputs: Sequence[Output]) -> list[Output]:
        """Note the engine's outputs. Before each session's end, insert the answers to events that a Close overtook."""
        settled: list[Output] = []
        for output in outputs:
            if self._late and isinstance(output, Outcome) and self._is_late(output):
                continue
            entry = self._entries.get(output.session)
            if entry is None:
                settled.append(output)
                continue
            if isinstance(output, Chunk):
                entry.num_frames += len(output.rows)
            elif isinstance(output, Opened):
                entry.is_open = True
                self._late.pop(output.session, None)  # the engine has processed all that came before it
                entry.unanswered.pop(entry.open_seq, None)
            elif isinstance(output, Closed):
                if not self._is_asked_for(output, entry):
                    self._expect_late(output.session, entry)
                settled += self._overtaken(output.session, entry)
                self._forget(output.session)
            settled.append(output)
            if isinstance(output, Outcome):
                entry.unanswered.pop(output.event_seq, None)
                if output.event_seq == entry.open_seq and not entry.is_open and output.code is not Code.OK:
                    settled += self._refuse(output.session, entry)
        return settled

    def _is_asked_for(self, closed: Closed, entry: Entry) -> bool:
        """Whether the session's Close caused this: then the engine drops the events after it."""
        return entry.close is not None and closed.session not in self._closing and closed.reason is entry.close.reason

    def _refuse(self, key: SessionKey, entry: Entry) -> list[Output]:
        """The engine has refused an Open, and will refuse what was sent after it: returns the answers to all of that.

        They are given at once: the key may be used again before the engine processes these events, which do not belong
        to the next session.
        """
        close_seqs = () if entry.close is None else (entry.close.event_seq,)
        self._expect_late(key, entry)
        self._forget(key)
        return self._overtaken(key, entry) + self._cancelled(key, close_seqs)

    def _expect_late(self, key: SessionKey, entry: Entry) -> None:
        """Remember the events of an ended session that are on their way, and that the engine will refuse."""
        never_sent = entry.unsent.union(entry.held_back)
        seqs = {seq for seq in entry.unanswered if seq not in never_sent}
        close_seq = 0 if entry.close is None or key in self._closing else entry.close.event_seq
        if close_seq:
            seqs.add(close_seq)
        if seqs:
            self._late.setdefault(key, deque()).append(Late(seqs, close_seq))

    def _is_late(self, answer: Outcome) -> bool:
        """Whether this was already answered here. The engine answers events of a key in the order of their arrival."""
        sessions = self._late.get(answer.session)
        if sessions is None or answer.event_seq not in sessions[0].seqs:
            return False
        first = sessions[0]
        first.seqs.remove(answer.event_seq)
        if answer.event_seq == first.close_seq or not first.seqs:
            sessions.popleft()
            if not sessions:
                del self._late[answer.session]
        return True

    def _overtaken(self, key: SessionKey, entry: Entry) -> list[Output]:
        """The answers to events that a Close has overtaken; those that still wait are never sent."""
        self._answered |= {(key, seq) for seq in entry.unsent}
        return self._cancelled(key, entry.unanswered)

    def _forget(self, key: SessionKey) -> None:
        self.num_clips -= self._entries.pop(key).is_clip
        self._closing.pop(key, None)
        self._new.discard(key)

    @staticmethod
    def _cancelled(key: SessionKey, event_seqs: Iterable[int]) -> list[Output]:
        return [session_closed().outcome(key, seq) for seq in event_seqs]

    def end_all(self, reason: CloseReason, message: str) -> list[Output]:
        """The engine process is gone: returns an end for every session, and an answer to everything unanswered."""
        outputs: list[Output] = []
        for key, entry in self._entries.items():
            entry.unanswered.pop(entry.open_seq, None)
            if entry.is_open:
                outputs += self._cancelled(key, entry.unanswered)
                outputs.append(Closed(key, reason, Code.UNAVAILABLE, message, entry.num_frames, 0))
            else:
                outputs.append(engine_restarting(RETRY_AFTER_S).outcome(key, entry.open_seq))
                closes = () if entry.close is None else (entry.close.event_seq,)
                outputs += self._cancelled(key, [*entry.unanswered, *closes])
        self._entries.clear()
        self._closing.clear()
        self._answered.clear()
        self._late.clear()
        self._new.clear()
        self._number = self.num_clips = 0
        return outputs


def no_room(priority: Priority, steps: int, retry_after_s: float) -> EventRefused:
    """The answer to an Open that no engine would admit, by what they last reported."""
    asked = f"class {priority.name} with {steps} denoising steps"
    given = f"the machine has no room for another session of {asked}; try again later, or ask for fewer steps"
    allowed = "a session for which there is room, one of a more urgent class, or another server"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "OVERLOADED", given, "open", allowed, retry_after_s)
