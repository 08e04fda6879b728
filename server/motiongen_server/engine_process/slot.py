"""Slot: one loaded model of an engine process: its engine on a thread of its own, and the events that wait for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from motiongen_server.engine.engine import Engine
from motiongen_server.engine.loop import run as run_loop
from motiongen_server.engine.mailbox import Mailbox
from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine.types import ModelFacts, Owner, StepsOf
from motiongen_server.engine_process.arrivals import Arrivals
from motiongen_server.engine_process.messages import CloseAhead, Events
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities

UNBOUNDED = 1 << 62
MOST_WAITING = 2048
"""If more events of a slot wait for its engine, no more are read. The gateway bounds those of each session."""


@dataclass(frozen=True)
class Built:
    """An engine that is loaded and warm, and what the gateway is told about it."""

    engine: Engine
    facts: ModelFacts
    licence: str
    abilities: Abilities = NOTHING_CLAIMED
    weights: str = ""


BuildEngine = Callable[[str, Deliver, Observe, Inbox], Built]
"""Loads the model of a source and makes its engine. Raises SettingError that says what is wrong with the settings."""


class Slot:
    """`take` and `stop` belong to the thread that reads the sockets; the engine takes its events from `inbox`."""

    def __init__(self, number: int, deliver: Deliver) -> None:
        self.number = number
        self.inbox = Mailbox(UNBOUNDED)
        self._deliver = deliver
        self._arrivals = Arrivals()
        self._engine: Engine | None = None
        self._thread: threading.Thread | None = None

    def start(self, engine: Engine, ended: Callable[[Slot, BaseException | None], None]) -> None:
        """Run the engine until it is stopped or fails. ended: called then, on the engine's thread."""

        def run() -> None:
            ended(self, run_loop(engine))

        self._engine = engine
        self._thread = threading.Thread(target=run, name=f"engine-{self.number}", daemon=True)
        self._thread.start()

    @property
    def is_busy(self) -> bool:
        """Whether a session or a clip is open."""
        return self._engine is not None and self._engine.num_sessions > 0

    @property
    def is_full(self) -> bool:
        """Whether so many events wait that no more should be read."""
        return len(self.inbox) > MOST_WAITING

    def take(self, message: Events | CloseAhead) -> None:
        """Pass what has arrived to the engine. If it refuses an event, the refusal is delivered at once."""
        if self._engine is None:
            return
        ahead = isinstance(message, CloseAhead)
        for event in self._arrivals.ahead(message) if ahead else self._arrivals.in_order(message):  # type: ignore[arg-type]
            refusal = self._engine.submit(event)
            if refusal is not None:
                self._deliver((refusal,))

    def note_steps_elsewhere(self, taken: StepsOf) -> None:
        """Tell the engine what others did for owners that have a quota. From any thread."""
        if self._engine is not None:
            self._engine.intake.note_steps_elsewhere(taken)

    def note_owner(self, owner: Owner) -> None:
        """Tell the engine what an owner may have from now on. From any thread."""
        if self._engine is not None:
            self._engine.intake.note_owner(owner)

    def stop(self) -> None:
        """Tell the engine to finish."""
        if self._engine is not None:
            self._engine.stop()

    def join(self) -> None:
        """Wait for the engine's end."""
        if self._thread is not None:
            self._thread.join()
