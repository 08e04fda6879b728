"""AbsentModels: models that an engine process held before, and that the next one finds changed or cannot load."""

from __future__ import annotations

import logging
import time

from motiongen_server.engine.engine_port import ModelLost
from motiongen_server.engine_process.connection import EngineLost
from motiongen_server.engine_process.control import ControlQueue
from motiongen_server.engine_process.messages import Unload
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.engine_process.silence import LOAD_AGAIN_S

_log = logging.getLogger(__name__)

MOST_REST_S = 600.0
"""However often it could not be loaded: each attempt takes time of the device from those that are served."""


class AbsentModels:
    """Of one engine process after the other, which serve their other models meanwhile. Used by their thread.

    awaited_s: for how long those have been awaited that are loaded again, since one of them came.
    """

    def __init__(self, engine: str, control: ControlQueue, rest_s: float) -> None:
        """engine: its name. rest_s: before what could not be loaded is tried again; twice as long each time after."""
        self._engine = engine
        self._control = control
        self._rest_s = rest_s
        self.awaited_s = 0.0
        self._due_at: dict[int, float] = {}  # by slot
        self._stuck: set[int] = set()  # of these it has been said
        self._rested_s: dict[int, float] = {}  # likewise: before the last attempt of this process

    def begin(self) -> None:
        """A new process loads all models, those too that the one before it served without."""
        self.awaited_s = 0.0
        self._due_at.clear()
        self._rested_s.clear()
        self._stuck.clear()

    def change(self, link: ModelLink) -> None:
        """Another model has been loaded in its place, which nobody has asked to be served.

        It is not tried again: the whole of it would be loaded each time beside those that are at work.
        """
        link.is_absent = True
        model_id = link.ready.result().facts.model_id
        self._lose(
            link,
            f"{link.source!r} holds another model by now than the one that was served as {model_id}: reload it to "
            "serve that, or put the one before back and reload it",
            "its weights have changed on the server, whose operator has to reload it",
        )
        self._control.tell(Unload(link.slot))

    def fail(self, link: ModelLink, error: str) -> None:
        """It could not be loaded: it is tried again after a rest, since a disk or a device may have been to blame.

        Raises EngineLost where the process is left with no model: the next process may be better off.
        """
        link.is_absent = True
        if all(each.is_absent for each in self._control):
            raise EngineLost(f"{link.source!r} cannot be loaded again: {error}")
        rest_s = min(2 * self._rested_s.get(link.slot, self._rest_s / 2), max(self._rest_s, MOST_REST_S))
        self._rested_s[link.slot], self._due_at[link.slot] = rest_s, time.monotonic() + rest_s
        self._lose(
            link,
            f"{link.source!r} cannot be loaded again, and is tried once more within {rest_s:g} s: {error}",
            "the server could not load it again",
        )

    def look(self, awaited_s: float) -> None:
        """Have those loaded that it is time for, and give up what does not come to an end of being loaded."""
        self.awaited_s = awaited_s
        if awaited_s > LOAD_AGAIN_S and any(link.is_up for link in self._control):  # else the process is lost
            self._give_up_stuck()
        now = time.monotonic()
        for slot in [slot for slot, at in self._due_at.items() if at <= now]:
            del self._due_at[slot]
            self._control.load_again(slot)

    def _give_up_stuck(self) -> None:
        for link in self._control:
            if link.ready.done() and not (link.is_up or link.is_absent or link.slot in self._stuck):
                self._stuck.add(link.slot)
                self._lose(
                    link,
                    f"{link.source!r} has been loading again for {self.awaited_s:.0f} s, as where a disk or a device "
                    "hangs: mend that, or end the engine process, which is started anew",
                    "the server does not come to an end of loading it again",
                )

    def _lose(self, link: ModelLink, message: str, told: str) -> None:
        _log.error("engine %s serves on without a model: %s", self._engine, message)
        link.failure = ModelLost(message, told)
