"""AbsentModels: models of a lost engine process that its replacement finds changed or cannot load."""

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
"""Longest time between attempts to load a model. Attempts go on, but each takes device time from served models."""


class AbsentModels:
    """The models that are missing while an engine process or its successor serves the others. Used by their thread.

    awaited_s: for how long models have been loading again, counted from when the last of them finished.
    """

    def __init__(self, engine: str, control: ControlQueue, rest_s: float) -> None:
        """engine: its name. rest_s: time before a model that could not be loaded is retried; it doubles each time."""
        self._engine = engine
        self._control = control
        self._rest_s = rest_s
        self.awaited_s = 0.0
        self._due_at: dict[int, float] = {}  # when to retry, by slot
        self._stuck: set[int] = set()  # slots already reported as not finishing
        self._rested_s: dict[int, float] = {}  # by slot: the rest before this process's last attempt

    def begin(self) -> None:
        """A new process loads all models, including those that the one before it served without."""
        self.awaited_s = 0.0
        self._due_at.clear()
        self._rested_s.clear()
        self._stuck.clear()

    def change(self, link: ModelLink) -> None:
        """A different model was loaded from its source. It is unloaded: nobody asked for it to be served.

        It is not retried, because each attempt would load a whole model beside those that are at work.
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
        """It could not be loaded. It is retried after a rest, because a disk or a device may have been the cause.

        Raises EngineLost if the process is left without any model: a new process may do better.
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
        """Retry the models that are due, and report those whose loading does not end as failed."""
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
