"""Silence: how long engines of a process have sent nothing, or models that it held have not been loaded again."""

from __future__ import annotations

import time
from collections.abc import Iterable

from motiongen_server.engine_process.connection import EngineLost
from motiongen_server.engine_process.model_link import ModelLink

LOAD_AGAIN_S = 600.0
"""If no further model is loaded again for this long, a driver or a disk hangs. This does not hold for a model that was
never loaded, such as one from the hub: nobody knows how long that takes.
"""


class Silence:
    """Watches the models of one engine process while it serves. Used by its thread."""

    def __init__(self, links: Iterable[ModelLink], most_at_once_s: float) -> None:
        """most_at_once_s: how much of the time between two calls of `look` counts at most. If this process was stopped
        for a while, the engine process is not to blame.
        """
        self._links = links
        self._most_at_once_s = most_at_once_s
        self._looked_at = time.monotonic()
        self._missing: frozenset[int] = frozenset()  # slots of models that are loaded again
        self.missing_s = 0.0  # since one of them came back

    def look(self) -> None:
        """Add the time that has passed. A model's own messages reset its `silent_s`."""
        now = time.monotonic()
        passed_s, self._looked_at = min(now - self._looked_at, self._most_at_once_s), now
        for link in self._links:
            link.silent_s = link.silent_s + passed_s if link.is_up else 0.0
        missing = frozenset(
            link.slot for link in self._links if link.ready.done() and not link.is_up and not link.is_absent
        )
        self.missing_s = self.missing_s + passed_s if missing and missing == self._missing else 0.0
        self._missing = missing

    def check(self, hung_s: float) -> None:
        """Raises EngineLost if an engine has sent nothing for `hung_s`, whatever the others send, or if none of the
        models that were held is loaded again.
        """
        silent_s = max((link.silent_s for link in self._links), default=0.0)
        if silent_s > hung_s:
            raise EngineLost(f"an engine of the process has said nothing for {silent_s:.1f} s")
        if self.missing_s > LOAD_AGAIN_S and not any(link.is_up for link in self._links):
            raise EngineLost(
                f"the process has been loading again what the one before it held for {self.missing_s:.0f} s"
            )
