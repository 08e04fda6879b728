"""When a window was asked for, made and sent, for traces. Seconds of the machine's monotonic clock."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.engine.types.names import PlanCause


@dataclass(frozen=True, slots=True)
class WindowTiming:
    """What an engine knows of a window. asked_at: when the first of its edits arrived, or when the window became due.

    created_at: it was given to the scheduler; begun_at: its first denoising step began; landed_at: its frames became
    the plan. num_steps: denoising steps. engine: the process that made it.
    """

    asked_at: float
    created_at: float
    begun_at: float
    landed_at: float
    num_steps: int
    engine: str


@dataclass(frozen=True, slots=True)
class WindowTrace:
    """A window from event to frame, as the gateway knows it. session, model_id, request_id: as the client is told them.

    is_sent: whether its frames were written to the client; sent_at: when the first of them was, or, if not, when a
    later plan replaced them or the client left. num_events: edits that first take effect in it.
    """

    timing: WindowTiming
    session: str
    request_id: str
    model_id: str
    plan: int
    first_frame: int
    cause: PlanCause
    num_events: int
    sent_at: float
    is_sent: bool
