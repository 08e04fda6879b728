"""EnginePort: all that the service and the application use of an engine, wherever it runs."""

from __future__ import annotations

from typing import Protocol

from motiongen_server.engine.types import Event, EventRefused, Outcome, Owner, Priority


class EventSink(Protocol):
    """The way into the engine, for a stream."""

    def submit(self, event: Event) -> Outcome | None:
        """Hand in an event; an outcome that comes back at once is a refusal.

        Returns at once, whatever the engine is busy with. Every other answer comes through `Deliver`.
        """
        ...

    def refusal_of(self, priority: Priority, denoise_steps: int, *, is_clip: bool = False) -> EventRefused | None:
        """Why a session, or the sample of a clip, would not be let in as things stand; no place is held.

        Returns at once and costs little: asked before the rest of an Open is read and its prompts are encoded.
        """
        ...


class EnginePort(EventSink, Protocol):
    """A model's engine, or what stands for all of them. It takes events. Everything may be called from any thread."""

    @property
    def num_sessions(self) -> int:
        """Sessions that are open in the engine."""
        ...

    @property
    def heartbeat_at(self) -> float:
        """When its loop last went round, in monotonic seconds of this machine."""
        ...

    @property
    def failure(self) -> BaseException | None:
        """What ended it, if it did not end as it should."""
        ...

    @property
    def free_share(self) -> float:
        """Of all that sessions may take, the share that is left to new ones, 0 to 1: a reading of this moment."""
        ...

    def note_owner(self, owner: Owner) -> None:
        """An owner has another share and quota from now on; they hold for the sessions that it has, too."""
        ...

    def drain(self) -> None:
        """Take no new sessions; those that are open are served on."""
        ...

    def stop(self) -> None:
        """Finish the windows that run, close every session as DRAINED, and end."""
        ...

    def join(self, timeout_s: float | None = None) -> bool:
        """Wait for the end. True if it has come."""
        ...
