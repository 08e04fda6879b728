"""ControlQueue: what an engine process is to hold, and the messages about it that wait to be sent."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

from motiongen_server.engine_process.connection import Connection
from motiongen_server.engine_process.messages import EncodeTexts, Load, Stop, ToEngine, Unload
from motiongen_server.engine_process.model_link import ModelLink


class ControlQueue:
    """Outlives engine processes: each new one is told what the one before it held. Everything from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._links: dict[int, ModelLink] = {}
        self._unsent: deque[ToEngine] = deque()  # for the process that there is now
        self._told_first: Callable[[], Sequence[ToEngine]] = tuple
        self._is_stopping = False
        self._is_closed = False

    def __iter__(self) -> Iterator[ModelLink]:
        """The models that are held, or being loaded or unloaded."""
        return iter(tuple(self._links.values()))

    def get(self, slot: int) -> ModelLink | None:
        """The model of a slot."""
        return self._links.get(slot)

    @property
    def is_loading(self) -> bool:
        """Whether a model has not been loaded once."""
        return any(not link.ready.done() for link in self)

    # ---- what there is to hold --------------------------------------------------------------------------------------

    def add(self, link: ModelLink) -> bool:
        """Have a model loaded. False where no engine process will ever load it."""
        with self._lock:
            if self._is_stopping or self._is_closed:
                return False
            self._links[link.slot] = link
            self._unsent.append(Load(link.slot, link.source))
            return True

    def load_again(self, slot: int) -> None:
        """Have the engine process try again to load a model that it could not load, unless that was given up."""
        with self._lock:
            if (link := self._links.get(slot)) is not None:
                link.is_absent = False
                self._unsent.append(Load(slot, link.source))

    def retire(self, link: ModelLink) -> bool:
        """Have a model unloaded. False where the engine process does not hold it: it is gone at once."""
        with self._lock:
            link.is_retired = True
            if link.is_up:
                self._unsent.append(Unload(link.slot))
                return True
            self._links.pop(link.slot, None)
            with suppress(ValueError):  # the engine process may be loading it already
                self._unsent.remove(Load(link.slot, link.source))
            return False

    def remove(self, link: ModelLink) -> None:
        """The engine process holds a model no more."""
        with self._lock:
            self._links.pop(link.slot, None)

    def serve_text(self, told_first: Callable[[], Sequence[ToEngine]]) -> bool:
        """told_first: what this process and each after it is told about prompts. False where none will be."""
        with self._lock:
            self._told_first = told_first
            self._unsent += told_first()
            return not self._is_closed

    # ---- what there is to say ---------------------------------------------------------------------------------------

    def tell(self, message: ToEngine) -> bool:
        """Have a message sent ahead of events. False where no process will come any more to take it."""
        with self._lock:
            if not self._is_closed:
                self._unsent.append(message)
            return not self._is_closed

    def stop(self) -> None:
        """Have the process end, and load nothing more."""
        with self._lock:
            self._is_stopping = True
            self._unsent.append(Stop())

    def take(self) -> tuple[ToEngine, ...]:
        """All that waits to be sent."""
        with self._lock:
            unsent = tuple(self._unsent)
            self._unsent.clear()
            return unsent

    def send(self, connection: Connection) -> bool:
        """Send what waits and there is room for. True if events are left. On the engine process's own thread."""
        control = self.take()
        is_waiting = False
        for link in self:
            if link.has_events and connection.has_room and (events := link.take_events()) is not None:
                connection.send(events)
            is_waiting |= link.has_events
            for close in link.take_closes():
                connection.send_ahead(close)
        for message in control:
            connection.send_ahead(message)
        return is_waiting

    # ---- one process after the other --------------------------------------------------------------------------------

    def begin(self) -> list[ModelLink]:
        """Tell a new process all that it is to hold. Returns the models that were retired while there was none."""
        with self._lock:
            retired = [link for link in self._links.values() if link.is_retired]
            for link in retired:
                del self._links[link.slot]
            texts = [message for message in self._unsent if isinstance(message, EncodeTexts)]
            self._unsent.clear()
            self._unsent += [Load(link.slot, link.source) for link in self._links.values()]
            self._unsent += [*self._told_first(), *texts]
            if self._is_stopping:
                self._unsent.append(Stop())
        return retired

    def lose(self) -> list[ModelLink]:
        """The process is gone. Returns the models that the next one is not to hold: never loaded, or retired.

        The one that it was loading is the last to be loaded by the next: it may be what the process was lost by, and
        those behind it would never come.
        """
        with self._lock:
            self._unsent.clear()
            under_way = (slot for slot, link in self._links.items() if not link.is_up and not link.is_absent)
            if (slot := next(under_way, None)) is not None:
                self._links[slot] = self._links.pop(slot)
            gone = [link for link in self._links.values() if link.is_retired or not link.ready.done()]
            for link in gone:
                del self._links[link.slot]
        return gone

    def close(self) -> list[ModelLink]:
        """No process will come any more. Returns the models that were left."""
        with self._lock:
            self._is_closed = True
            links = list(self._links.values())
            self._links.clear()
        return links
