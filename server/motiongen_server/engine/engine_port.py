"""EnginePort: everything that the service and the application use of an engine, wherever it runs."""

from __future__ import annotations

from typing import Protocol

from motiongen_server.engine.types import Event, EventRefused, Outcome, Owner, Priority


class ModelLost(RuntimeError):
    """A model is not served although its engine process works. The message is for operators; told: the same for
    clients, without the path of its files.
    """

    def __init__(self, message: str, told: str) -> None:
        super().__init__(message)
        self.told = told


class EventSink(Protocol):
    """The part of an engine that streams use."""

    def submit(self, event: Event) -> Outcome | None:
        """Hand in an event; an outcome that is returned at once is a refusal.

        Never waits, whatever the engine is busy with. All other answers come through `Deliver`.
        """
        ...

    def refusal_of(self, priority: Priority, denoise_steps: int, *, is_clip: bool = False) -> EventRefused | None:
        """Why a session, or the sample of a clip, would be refused at present; None if admitted. Reserves nothing.

        Never waits and costs little: it is asked before the rest of an Open is read and its prompts are encoded.
        """
        ...


class EnginePort(EventSink, Protocol):
    """A model's engine, or what represents all engines of the model. Every member may be used from any thread."""

    @property
    def num_sessions(self) -> int:
        """Sessions open in the engine."""
        ...

    @property
    def heartbeat_at(self) -> float:
        """When its loop last began a round, in monotonic seconds of this machine."""
        ...

    @property
    def failure(self) -> BaseException | None:
        """Why the model is not served, if it should be; None again once it is served again.

        ModelLost if the engines work, but what the model is loaded from has changed or cannot be loaded.
        """
        ...

    @property
    def num_engines(self) -> int:
        """How many engines serve the model at this moment, each in a process of its own."""
        ...

    @property
    def free_share(self) -> float:
        """The share of the capacity for sessions that is left for new ones at this moment, 0 to 1."""
        ...

    def note_owner(self, owner: Owner) -> None:
        """From now on an owner has this share and quota, also for the sessions that it has already."""
        ...

    def drain(self) -> None:
        """Take no new sessions; open ones continue."""
        ...

    def stop(self) -> None:
        """Finish the running windows, close every session as DRAINED, and end."""
        ...

    def join(self, timeout_s: float | None = None) -> bool:
        """Wait for the engine to end. True if it has ended."""
        ...
