"""Ledger: what the gateway knows of every session in the engine process, so that none is left without an answer."""

from __future__ import annotations

from collections import Counter
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
from motiongen_server.engine.types.refusals import session_closed

RETRY_AFTER_S = 2.0


@dataclass(slots=True)
class Entry:
    """One session, from the Open that was submitted to the Closed that came back.

    unanswered: event_seqs without an Outcome, oldest first; unsent: those of them that still wait to be sent;
    held_back: those that are not sent, because the session is closing. opened, last: the numbers, on the way to the
    engine, of its Open and of its last event, 0 while they have not been sent. close: submitted, and to be sent ahead.
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


class Ledger:
    """The sessions of one engine process. Not thread-safe: its owner holds a lock."""

    def __init__(self) -> None:
        self._entries: dict[SessionKey, Entry] = {}
        self._closing: dict[SessionKey, Close] = {}
        self._refused: dict[SessionKey, Entry] = {}  # their Close is on its way, and the engine will answer it
        self._answered: set[tuple[SessionKey, int]] = set()  # here, before they were sent
        self._told: Counter[tuple[SessionKey, int]] = Counter()  # here, after they were sent: the engine's is dropped
        self._number = 0
        self.num_clips = 0
        self._new: set[SessionKey] = set()  # and still here

    def __contains__(self, session: SessionKey) -> bool:
        """Whether a session is open, about to be, or waits for the answer to a Close."""
        return session in self._entries or session in self._refused

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def num_played(self) -> int:
        """Sessions that are open, or about to be; clips left out."""
        return len(self._entries) - self.num_clips

    @property
    def num_new(self) -> int:
        """Those of them that were opened since `mark`."""
        return len(self._new)

    def mark(self) -> None:
        """From now on sessions that are opened are new."""
        self._new.clear()

    # ---- on the way to the engine -----------------------------------------------------------------------------------

    def note(self, event: Event) -> None:
        """An event has been taken in. The engine answers those of sessions that are not known here by itself."""
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
        """Whether an event is a Close of a known session, which does not wait behind other events."""
        return isinstance(event, Close) and event.session in self._entries

    def number(self, events: Iterable[Event]) -> tuple[int, list[Event]]:
        """The number of the first of these events, and those that are to be sent.

        Of a session that is closing, only the Open still goes; its Closed answers the rest.
        """
        sent: list[Event] = []
        first = self._number + 1
        for event in events:
            entry = self._entries.get(event.session)
            if (event.session, event.event_seq) in self._answered:
                self._answered.remove((event.session, event.event_seq))
                continue
            if entry is None and self._is_answered_with_close(event):
                continue
            if entry is not None:
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
        """Closes that can be sent, each with the numbers of its session's Open and last event."""
        ready = [key for key in self._closing if self._entries[key].opened]
        return [(self._closing.pop(key), self._entries[key].opened, self._entries[key].last) for key in ready]

    # ---- on the way back --------------------------------------------------------------------------------------------

    def settle(self, outputs: Sequence[Output]) -> list[Output]:
        """Enter what the engine has delivered, and answer before its session's end what a close has overtaken."""
        settled: list[Output] = []
        for output in outputs:
            if self._told and isinstance(output, Outcome) and self._told[(output.session, output.event_seq)]:
                self._told.subtract([(output.session, output.event_seq)])
                self._told += Counter()  # forgets what none is left of
                continue
            entry = self._entries.get(output.session)
            if entry is None:
                if self._refused:
                    settled += self._after_refusal(output)
                settled.append(output)
                continue
            if isinstance(output, Chunk):
                entry.num_frames += len(output.rows)
            elif isinstance(output, Opened):
                entry.is_open = True
                entry.unanswered.pop(entry.open_seq, None)
            elif isinstance(output, Closed):
                settled += self._overtaken(output.session, entry)
                self._forget(output.session)
            settled.append(output)
            if isinstance(output, Outcome):
                entry.unanswered.pop(output.event_seq, None)
                if output.event_seq == entry.open_seq and not entry.is_open and output.code is not Code.OK:
                    settled += self._refuse(output.session, entry)
        return settled

    def _refuse(self, key: SessionKey, entry: Entry) -> list[Output]:
        """The engine has refused an Open, and will refuse what has been sent after it: the answers to all else."""
        close = self._closing.get(key)
        self._forget(key)
        if entry.close is not None and close is None:
            self._refused[key] = entry
            return []
        # At once: the name may be used again before the engine comes to these, and they are not of the next session.
        never_sent = entry.unsent.union(entry.held_back)
        self._told.update((key, seq) for seq in entry.unanswered if seq not in never_sent)
        return self._overtaken(key, entry) + self._cancelled(key, () if close is None else (close.event_seq,))

    def _after_refusal(self, output: Output) -> list[Output]:
        """The answers that are due before the one to the Close of a session that was refused."""
        key = output.session
        entry = self._refused.get(key)
        if entry is None or entry.close is None or not isinstance(output, Outcome):
            return []
        entry.unanswered.pop(output.event_seq, None)
        if output.event_seq != entry.close.event_seq:
            return []
        del self._refused[key]
        return self._overtaken(key, entry)

    def _is_answered_with_close(self, event: Event) -> bool:
        """Whether the answer to the Close of a session that was refused meanwhile will bring that of an event too."""
        refused = self._refused.get(event.session)
        if refused is None or event.event_seq not in refused.unanswered:
            return False
        refused.unsent.discard(event.event_seq)
        return True

    def _overtaken(self, key: SessionKey, entry: Entry) -> list[Output]:
        """The answers to what a close has overtaken; what of it still waits to be sent will not be."""
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
        """The engine process is gone: an end for every session, and an answer for everything that waits for one."""
        outputs: list[Output] = []
        for key, entry in self._refused.items():
            close_seq = () if entry.close is None else (entry.close.event_seq,)
            outputs += self._cancelled(key, [*entry.unanswered, *close_seq])
        for key, entry in self._entries.items():
            entry.unanswered.pop(entry.open_seq, None)
            if entry.is_open:
                outputs += self._cancelled(key, entry.unanswered)
                outputs.append(Closed(key, reason, Code.UNAVAILABLE, message, entry.num_frames, 0))
            else:
                outputs.append(engine_restarting().outcome(key, entry.open_seq))
                closes = () if entry.close is None else (entry.close.event_seq,)
                outputs += self._cancelled(key, [*entry.unanswered, *closes])
        self._entries.clear()
        self._refused.clear()
        self._closing.clear()
        self._answered.clear()
        self._told.clear()
        self._new.clear()
        self._number = self.num_clips = 0
        return outputs


def engine_restarting() -> EventRefused:
    """The answer to an event while there is no engine process."""
    given = "the server's engine is being started anew; open a session again in a moment"
    return EventRefused(Code.UNAVAILABLE, "ENGINE_RESTARTING", given, retry_after_s=RETRY_AFTER_S)


def no_room(priority: Priority, steps: int, retry_after_s: float) -> EventRefused:
    """The answer to an Open that no engine lets in, as they last told."""
    asked = f"class {priority.name} with {steps} denoising steps"
    given = f"the machine has no room for another session of {asked}; try again later, or ask for fewer steps"
    allowed = "a session for which there is room, one of a more urgent class, or another server"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "OVERLOADED", given, "open", allowed, retry_after_s)
