"""StepReport: what one engine step did, for `app` to turn into metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from motiongen_server.engine.types.names import CloseReason, Code, PlanCause, PlayState, Priority, ServiceTier
from motiongen_server.engine.types.owner import StepsOf


@dataclass(frozen=True, slots=True)
class EventLatency:
    """Seconds from an edit's arrival to the delivery of the first frame that it changed."""

    priority: Priority
    kind: str
    seconds: float


@dataclass(slots=True)
class StepReport:
    """What one engine step did; `app` turns it into metrics. Lists hold a value for each occurrence in the step.

    rows: rows in the denoising step, 0 when there was none; bucket: the size it counts as in the cost table.
    windows: those accepted. slacks: seconds of frames that a client held when it reported its playhead.
    client_underruns: how many a client has newly reported. memory_splits: calls made smaller for want of memory.
    steps_discarded: those done for windows that were restarted or came too late. soft_resets: windows that righted a
    character. frames_held: frames that repeat a pose for want of a window. quota_steps: begun of late, by owners that
    have a quota.
    Where they were taken: sessions, how many there are; load, the share of the machine that is spoken for, by which
    others are let in; asked, what sessions of this engine are expected to ask for of it; tiers, what each class gets;
    places, how many more sessions of each class would be let in with the default steps, 0 where not even one with the
    fewest.
    """

    rows: int = 0
    bucket: int = 0
    prepare_seconds: float = 0.0
    step_seconds: float = 0.0
    decode_seconds: float = 0.0
    queue_waits: list[float] = field(default_factory=list)
    slacks: list[tuple[Priority, float]] = field(default_factory=list)
    deadlines: list[Priority] = field(default_factory=list)
    windows: list[tuple[Priority, PlanCause]] = field(default_factory=list)
    deadline_misses: list[Priority] = field(default_factory=list)
    frames_sent: int = 0
    frames_superseded: int = 0
    windows_discarded: int = 0
    windows_restarted: int = 0
    steps_discarded: int = 0
    nan_rows: int = 0
    runner_faults: int = 0
    memory_splits: int = 0
    soft_resets: int = 0
    frames_held: int = 0
    quota_steps: StepsOf = ()
    client_underruns: list[tuple[Priority, int]] = field(default_factory=list)
    event_latencies: list[EventLatency] = field(default_factory=list)
    opens: list[Code] = field(default_factory=list)
    closes: list[CloseReason] = field(default_factory=list)
    sessions: Mapping[tuple[Priority, PlayState], int] | None = None
    load: float | None = None
    asked: float | None = None
    tiers: Mapping[Priority, ServiceTier] | None = None
    places: Mapping[Priority, float] | None = None
