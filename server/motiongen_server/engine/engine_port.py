"""EnginePort: all that the service and the application use of an engine, wherever it runs."""

from __future__ import annotations

from typing import Protocol

from motiongen_server.engine.types import Event, EventRefused, Outcome, Owner, Priority


class ModelLost(RuntimeError):
    """Why a model is not served while others are, for who operates the server. told: the same for clients, who are not
    told where its weights are.
    """

    def __init__(self, message: str, told: str) -> None:
        super().__init__(message)
        self.told = told


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
        """Why it does not serve, if it did not end as it should; None again where it serves again.

        ModelLost where nothing has failed but what the model is loaded from.
        """
        ...

    @property
    def num_engines(self) -> int:
        """How many engines serve it at this moment, each in a process of its own."""
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
