"""StepReport: what one engine step did; `ops` turns it into metrics."""

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
    """What one engine step did. Lists hold one value per occurrence in the step.

    rows: rows in the denoising step, 0 if there was none; bucket: its size in the cost table. windows: those accepted.
    slacks: seconds of frames that a client held when it reported its playhead. client_underruns: underruns that clients
    newly reported. memory_splits: calls made smaller for lack of memory. steps_discarded: those done for windows that
    were restarted or came too late. soft_resets: windows that corrected a character. frames_held: frames that repeat a
    pose for lack of a window. quota_steps: steps that owners with a quota have begun since the last report.

    Only in steps that measured these: sessions, the number of open ones; load, the share of the machine that is in use
    or spoken for, by which sessions are admitted; asked, the share that this engine's sessions are expected to ask for;
    tiers, what each class gets; places, how many more sessions of each class would be admitted with the default steps,
    0 if not even one with the fewest steps.
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
