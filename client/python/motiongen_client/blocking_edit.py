"""Edit without asyncio: waits for the client's background thread only where it waits for the server's answer."""

from __future__ import annotations

from motiongen_client import edit
from motiongen_client.background_loop import BackgroundLoop
from motiongen_client.types import Outcome


class Edit:
    """A change that was sent to the server. `wait()` for its Outcome, or ignore it."""

    def __init__(self, loop: BackgroundLoop, inner: edit.Edit) -> None:
        self._loop = loop
        self._inner = inner
        self.constraint_ids = inner.constraint_ids
        self.prompt_id = inner.prompt_id

    @property
    def event_seq(self) -> int:
        """Its number in the session; it changes if the session has to be opened anew."""
        return self._inner.event_seq

    def wait(self) -> Outcome:
        """The server's answer. Raises EventRefused, SessionEnded or StreamLost."""

        async def work() -> Outcome:
            return await self._inner

        return self._inner.result() if self.done() else self._loop.run(work())

    def done(self) -> bool:
        """Whether the server has answered or never will, so that `wait` returns or raises at once."""
        return self._inner.done()

    @property
    def outcome(self) -> Outcome | None:
        """The server's answer, if it has accepted the change."""
        return self._inner.outcome

    @property
    def latency_s(self) -> float | None:
        """Seconds from sending the change to receiving the first frame it changed; None until then."""
        return self._inner.latency_s
