"""ControlQueue: the models that an engine process is to hold, and the messages for it that wait to be sent."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

from motiongen_server.engine_process.connection import Connection
from motiongen_server.engine_process.messages import EncodeTexts, Load, Stop, ToEngine, Unload
from motiongen_server.engine_process.model_link import ModelLink


class ControlQueue:
    """Outlives engine processes: each new one is told to load what the last one held. Used from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._links: dict[int, ModelLink] = {}
        self._unsent: deque[ToEngine] = deque()  # for the current process
        self._told_first: Callable[[], Sequence[ToEngine]] = tuple
        self._is_stopping = False
        self._is_closed = False

    def __iter__(self) -> Iterator[ModelLink]:
        """The models that are loaded, or being loaded or unloaded."""
        return iter(tuple(self._links.values()))

    def get(self, slot: int) -> ModelLink | None:
        """The model of a slot."""
        return self._links.get(slot)

    @property
    def is_loading(self) -> bool:
        """Whether a model is being loaded for the first time."""
        return any(not link.ready.done() for link in self)

    # ---- models -----------------------------------------------------------------------------------------------------

    def add(self, link: ModelLink) -> bool:
        """Request that a model is loaded. False if no engine process will ever load it."""
        with self._lock:
            if self._is_stopping or self._is_closed:
                return False
            self._links[link.slot] = link
            self._unsent.append(Load(link.slot, link.source))
            return True

    def load_again(self, slot: int) -> None:
        """Request again that a model is loaded that could not be, unless it was removed."""
        with self._lock:
            if (link := self._links.get(slot)) is not None:
                link.is_absent = False
                self._unsent.append(Load(slot, link.source))

    def retire(self, link: ModelLink) -> bool:
        """Request that a model is unloaded. False if the engine process does not hold it: it is gone at once."""
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
        """Note that the engine process no longer holds a model."""
        with self._lock:
            self._links.pop(link.slot, None)

    def serve_text(self, told_first: Callable[[], Sequence[ToEngine]]) -> bool:
        """told_first: returns what to tell this process and each later one about prompts. False if there is none."""
        with self._lock:
            self._told_first = told_first
            self._unsent += told_first()
            return not self._is_closed

    # ---- messages ---------------------------------------------------------------------------------------------------

    def tell(self, message: ToEngine) -> bool:
        """Queue a message that is sent ahead of events. False if there will be no process to receive it."""
        with self._lock:
            if not self._is_closed:
                self._unsent.append(message)
            return not self._is_closed

    def stop(self) -> None:
        """Tell the process to end, and load nothing more."""
        with self._lock:
            self._is_stopping = True
            self._unsent.append(Stop())

    def take(self) -> tuple[ToEngine, ...]:
        """Remove and return all that waits to be sent."""
        with self._lock:
            unsent = tuple(self._unsent)
            self._unsent.clear()
            return unsent

    def send(self, connection: Connection) -> bool:
        """Send what waits, as far as there is room. True if events are left. On the engine process's own thread."""
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
        """Tell a new process all that it is to hold. Returns the models retired while there was no process."""
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
        """The process is lost. Returns the models that the next one is not to hold: never loaded, or retired.

        The next process loads the model that this one was loading last: that model may have caused the loss, and those
        after it would never be loaded.
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
        """There will be no further process. Returns the models that were left."""
        with self._lock:
            self._is_closed = True
            links = list(self._links.values())
            self._links.clear()
        return links
