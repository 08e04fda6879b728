"""Silence: for how long the engines of a process have said nothing."""

from __future__ import annotations

import time
from collections.abc import Iterable

from motiongen_server.engine_process.model_link import ModelLink


class Silence:
    """Of the models of one engine process, while it serves. Used by its thread."""

    def __init__(self, links: Iterable[ModelLink], most_at_once_s: float) -> None:
        """most_at_once_s: what counts of the time between two looks. Not all of it: when this process was stopped for
        a while, the engine process is not to blame.
        """
        self._links = links
        self._most_at_once_s = most_at_once_s
        self._looked_at = time.monotonic()

    def look(self) -> None:
        """Note that time has passed. What is said takes back its own model's."""
        now = time.monotonic()
        passed_s, self._looked_at = min(now - self._looked_at, self._most_at_once_s), now
        for link in self._links:
            link.silent_s = link.silent_s + passed_s if link.is_up else 0.0

    @property
    def longest_s(self) -> float:
        """Of the model whose engine has said nothing for longest."""
        return max((link.silent_s for link in self._links), default=0.0)
