"""EngineThread: an engine whose loop runs on its own thread."""

from __future__ import annotations

import threading

from motiongen_server.engine import loop
from motiongen_server.engine.engine import Engine


class EngineThread:
    """Starts at once. failure: the exception that ended the loop, if any."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="engine", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        self.failure = loop.run(self._engine)

    def join(self, timeout_s: float | None = None) -> bool:
        """Wait for the loop to end. True if it has."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()
