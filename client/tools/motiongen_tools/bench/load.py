"""What a run is to play, and what the generator processes report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from motiongen_client.errors import MotiongenError
from motiongen_tools.bench.recorder import PackedBook, Recorder
from motiongen_tools.bench.scenario import Scenario
from motiongen_tools.bench.schedule import Phases, Schedule, make_schedule
from motiongen_tools.connection import PLAIN, Connection


class GeneratorFailed(MotiongenError):
    """A generator process ended without its report."""


@dataclass(frozen=True)
class Load:
    """What is to be played, the same for all processes.

    seconds: of measuring, after ramp and settling. denoise_steps: None leaves them to the server. connection: how the
    server is reached. program: a motiongen-load that plays it; None: processes of this package.
    """

    address: str
    scenario: Scenario
    characters: int
    seconds: int
    seed: int
    denoise_steps: int | None = None
    processes: int = 1
    connection: Connection = PLAIN
    program: Path | None = None

    def schedule(self) -> Schedule:
        return make_schedule(self.scenario, self.characters, self.seconds, self.seed)

    def num_streams(self, schedule: Schedule, max_sessions_per_stream: int) -> int:
        """The number of streams of all processes; characters are dealt to them in turn."""
        at_once = min(self.scenario.characters_per_stream, max_sessions_per_stream)
        return max(math.ceil(max(schedule.most_at_once(), 1) / at_once), self.processes)

    def new_book(self, phases: Phases) -> Recorder:
        return Recorder(tuple(group.name for group in self.scenario.groups), math.ceil(phases.end_s))


@dataclass(frozen=True)
class Progress:
    """Progress of one process. missed: frames in the last second; edits, refused: so far."""

    process: int
    at_s: float
    playing: int
    missed: int
    edits: int
    refused: int


@dataclass(frozen=True)
class Report:
    """One process's report. cpu_s: its own, while measuring; streams: calls it held; program: what played the load."""

    process: int
    recorder: PackedBook
    cpu_s: float
    streams: int
    program: str = "motiongen_tools"
