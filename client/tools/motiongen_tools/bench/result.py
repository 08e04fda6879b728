"""The results of a run: figures, whether they count, and all of it as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from motiongen_client.types import Priority
from motiongen_tools.bench.load import Load, Report
from motiongen_tools.bench.recorder import (
    ALL,
    BY_SECOND,
    EVENT,
    GENERATOR,
    GENERATOR_LAGS,
    LATENCIES,
    ROUND_TRIP,
    STREAMS,
    VOIDING_LAGS,
    Recorder,
    summary_ms,
)
from motiongen_tools.bench.schedule import Phases
from motiongen_tools.bench.server_use import ServerUse

_FULL = "service level: FULL"


@dataclass(frozen=True)
class Standard:
    """Served in full: fewer misses than max_miss_ratio. Figures count: the load's p99 lag is at most max_lag_ms."""

    max_miss_ratio: float = 0.01
    max_lag_ms: float = 5.0


@dataclass(frozen=True)
class Figures:
    """Figures of a group or of all, while measuring. missed: frames that were not there when playback needed them.

    miss_ratio: missed frames per frame due; if nothing was due, 1 if the group has anyone, otherwise 0. frames_per_s:
    received; on_time_per_s: played when due. underruns: how often playback stood still.
    """

    due: int
    missed: int
    miss_ratio: float
    underruns: int
    frames_per_s: float
    on_time_per_s: float
    opens: int
    edits: int
    refused: int


@dataclass(frozen=True)
class Result:
    """One run. generator_cores: of each process, processor seconds a second. server_use: None for a server that was not
    started by the command. program: what played the load.
    """

    started_at: str
    load: Load
    schedule_sha256: str
    phases: Phases
    server: dict[str, str]
    machine: dict[str, str]
    streams: int
    recorder: Recorder
    generator_cores: tuple[float, ...]
    server_use: ServerUse | None
    standard: Standard
    program: str = "motiongen_tools"

    def figures(self, group: str = ALL) -> Figures:
        sums = {name: self.recorder.total(name, *self._measured, group) for name in BY_SECOND}
        due, missed, seconds = sums["due"], sums["missed"], self.phases.measure_s
        return Figures(
            due=round(due),
            missed=round(missed),
            miss_ratio=missed / due if due else float(self._has_anyone(group)),
            underruns=round(sums["underruns"]),
            frames_per_s=sums["frames"] / seconds,
            on_time_per_s=max(due - missed, 0.0) / seconds,
            opens=round(sums["opens"]),
            edits=round(sums["edits"]),
            refused=round(sums["refused"]),
        )

    def latency_ms(self, what: str, group: str = ALL) -> dict[str, float]:
        return summary_ms(self.recorder.histogram(what, group))

    def void_reasons(self) -> list[str]:
        """Why the figures do not count: the generator itself was late. Empty if they count."""
        reasons, allowed_ms = [], self.standard.max_lag_ms
        for what in VOIDING_LAGS:
            lag = self.latency_ms(what, GENERATOR)
            if lag["count"] and lag["p99"] > allowed_ms:
                name = what.replace("_", " ")
                reasons.append(f"the generator's {name} was {lag['p99']:.1f} ms (p99); {allowed_ms:g} ms is allowed")
        return reasons

    def shortfalls(self) -> list[str]:
        """In what respect characters were not served in full. Empty if they were."""
        found = []
        ratio, allowed = self.figures().miss_ratio, self.standard.max_miss_ratio
        if ratio >= allowed:
            found.append(f"{ratio:.2%} of frames were missed; less than {allowed:.2%} is allowed")
        for group in self.load.scenario.groups:
            underruns = self.figures(group.name).underruns
            if group.priority is Priority.HERO and underruns:
                found.append(f"playback of {group.name} stood still {underruns} times; HERO never may")
        for name, count in self.counts():
            if name.startswith(_COUNTED_AGAINST) and not name.startswith(_FULL):
                found.append(f"{name.replace('_', ' ')} ({count:,} times)")
        return found

    def counts(self) -> list[tuple[str, int]]:
        """What was counted in the whole run, by name."""
        return sorted(self.recorder.counts.items())

    def groups(self) -> list[str]:
        """`all`, and each group if there are several."""
        names = [group.name for group in self.load.scenario.groups]
        return [ALL, *names] if len(names) > 1 else [ALL]

    def headline(self) -> str:
        """The run in one line."""
        figures, event = self.figures(), self.latency_ms(EVENT)
        line = (
            f"{self.load.scenario.name}, {self.load.characters} characters: {figures.miss_ratio:.2%} of frames missed"
        )
        if event["count"]:
            line += f"; event to first changed frame {event['p50']:.0f} ms (p50), {event['p99']:.0f} ms (p99)"
        return line

    def document(self) -> dict[str, Any]:
        """Everything as JSON. histograms: HdrHistogram's own format, microseconds, base64."""
        groups = [ALL, *(group.name for group in self.load.scenario.groups)]
        scenario = self.load.scenario
        return {
            "started_at": self.started_at,
            "void": self.void_reasons(),
            "shortfalls": self.shortfalls(),
            "max_miss_ratio": self.standard.max_miss_ratio,
            "scenario": {"name": scenario.name, "revision": scenario.revision, "sha256": scenario.sha256},
            "load": {
                "characters": self.load.characters,
                "seconds": self.load.seconds,
                "seed": self.load.seed,
                "denoise_steps": self.load.denoise_steps,
                "streams": self.streams,
                "processes": self.load.processes,
                "schedule_sha256": self.schedule_sha256,
            },
            "phases": asdict(self.phases),
            "server": self.server,
            "server_use": None if self.server_use is None else asdict(self.server_use),
            "machine": self.machine,
            "generator": {
                "program": self.program,
                "cores": list(self.generator_cores),
                "max_lag_ms": self.standard.max_lag_ms,
                **{f"{what}_ms": self.latency_ms(what, GENERATOR) for what in GENERATOR_LAGS},
            },
            "round_trip_ms": self.latency_ms(ROUND_TRIP, STREAMS),
            "figures": {group: asdict(self.figures(group)) for group in groups},
            "latencies_ms": {what: {group: self.latency_ms(what, group) for group in groups} for what in LATENCIES},
            "counts": dict(self.counts()),
            "by_second": {name: [round(value, 3) for value in self.recorder.by_second(name)] for name in BY_SECOND},
            "histograms": {
                f"{what}/{group}": encoded.decode()
                for (what, group), encoded in sorted(self.recorder.pack().histograms.items())
            },
        }

    def _has_anyone(self, group: str) -> bool:
        """Whether the load has any character of the group: of few characters, a small share may be none."""
        groups = self.load.scenario.groups
        return group == ALL or group in {groups[n].name for n in self.load.scenario.group_indices(self.load.characters)}

    @property
    def _measured(self) -> tuple[int, int]:
        return self.phases.measure_from_s, self.phases.measure_to_s


_COUNTED_AGAINST = (
    "refused open",
    "refused edit",
    "sessions_lost",
    "streams_lost",
    "service level",
    "protocol_breaches",
)


def merge_reports(recorder: Recorder, reports: Sequence[Report]) -> Recorder:
    """The measurements of all processes, in one recorder."""
    for report in reports:
        recorder.merge(report.recorder)
    return recorder
