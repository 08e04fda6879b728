"""Stage: an engine with a fake runner in virtual time, and viewers that play its frames."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.scheduling.device import DeviceLease
from motiongen_server.engine.scheduling.policy import SchedulingPolicy
from motiongen_server.engine.types import (
    NOBODY,
    Close,
    Code,
    Constraint,
    Gait,
    Guidance,
    ModelFacts,
    Open,
    Outcome,
    Output,
    Owner,
    PlayState,
    Priority,
    Prompt,
    Seek,
    ServiceTier,
    SessionKey,
    SessionSpec,
    SetConstraints,
    SetOptions,
    SetPlayState,
    SetPrompts,
    SetVelocity,
    StartPose,
)
from motiongen_server.engine.types.report import StepReport
from tests.server.engine.fakes import FACTS, FakeClock, FakeRunner
from tests.server.engine.viewer import Viewer


def prompt(marker: int, prompt_id: int = 1, start: int | None = None, end: int | None = None) -> Prompt:
    """A prompt whose frames carry `marker` in their PROMPT column."""
    return Prompt(prompt_id, start, end, f"prompt {marker}", np.array([marker, 0], np.float32))


def spec(
    key: SessionKey,
    *,
    seed: int = 1,
    priority: Priority = Priority.NEAR,
    lookahead: int = 40,
    num_steps: int = 4,
    prompts: tuple[Prompt, ...] = (),
    constraints: tuple[Constraint, ...] = (),
    history_frames: int | None = None,
    prior_rows: np.ndarray | None = None,
    clip_frames: int | None = None,
    gaits: tuple[Gait, ...] = (),
    keep_prompts: bool = False,
    owner: Owner = NOBODY,
    outputs: tuple[str, ...] = (),
) -> SessionSpec:
    return SessionSpec(
        key,
        seed,
        "fake",
        priority,
        lookahead,
        num_steps,
        Guidance(2.0, 2.0),
        prompts=prompts,
        constraints=constraints,
        history_frames=history_frames,
        prior_rows=prior_rows,
        clip_frames=clip_frames,
        gaits=gaits,
        keep_prompts=keep_prompts,
        owner=owner,
        outputs=outputs,
    )


_Edit: TypeAlias = SetPrompts | SetConstraints | SetVelocity | SetPlayState | SetOptions | Seek


class Stage:
    """Drives the engine by hand. Viewers report their playheads every `report_every_s`, unless told to be silent.

    delay_s: the delay of everything between viewers and engine, in both directions. clock, lease: shared by several
    stages whose steps are run in turn by the test.
    """

    def __init__(
        self,
        config: EngineConfig | None = None,
        report_every_s: float = 0.5,
        delay_s: float = 0.0,
        scheduler: SchedulingPolicy | None = None,
        facts: ModelFacts = FACTS,
        *,
        clock: FakeClock | None = None,
        lease: DeviceLease | None = None,
    ) -> None:
        self._delay_s = delay_s
        self._under_way: deque[tuple[float, Callable[[float], object]]] = deque()
        self.clock = FakeClock() if clock is None else clock
        self.clock.ticked = self._let_arrive
        self.runner = FakeRunner(self.clock)
        self.runner.facts = facts
        self.engine = Engine(
            self.runner,
            self.clock,
            lambda outputs: self.deliver(outputs),
            config or EngineConfig(),
            scheduler=scheduler,
            lease=lease,
        )
        self.viewers: dict[SessionKey, Viewer] = {}
        self.reports: list[StepReport] = []
        self.outputs: list[Output] = []
        self.silent: set[SessionKey] = set()
        self._report_every_s = report_every_s
        self.next_report_at: dict[SessionKey, float] = {}
        self._seqs = itertools.count(1)
        self._askers: dict[int, Viewer] = {}

    # ---- what a client does -----------------------------------------------------------------------------------------

    def open(self, handle: int = 1, **fields: object) -> Viewer:
        key = SessionKey(1, handle)
        session = spec(key, **fields)  # type: ignore[arg-type]
        viewer = Viewer(key, session.lookahead, FACTS.fps)
        self.viewers[key] = viewer
        self.next_report_at[key] = 0.0
        seq = next(self._seqs)
        self._carry(lambda now: self._submit(viewer, Open(session, seq, now)))
        return viewer

    def open_clip(self, handle: int, clip_frames: int, **fields: object) -> Viewer:
        """Open a clip, which is not played, so that no playheads are reported."""
        self.silent.add(SessionKey(1, handle))
        fields = {"priority": Priority.BATCH, "lookahead": clip_frames, **fields}
        return self.open(handle, clip_frames=clip_frames, **fields)

    def set_prompts(self, viewer: Viewer, *upsert: Prompt, remove: tuple[int, ...] = ()) -> int:
        return self._ask(viewer, lambda seq, now: SetPrompts(viewer.key, seq, now, upsert, remove))

    def set_constraints(
        self, viewer: Viewer, *upsert: Constraint, remove: tuple[int, ...] = (), clear: bool = False
    ) -> int:
        return self._ask(viewer, lambda seq, now: SetConstraints(viewer.key, seq, now, upsert, remove, clear))

    def set_velocity(
        self,
        viewer: Viewer,
        x: float,
        z: float,
        heading: float | None = None,
        hold_frames: int = 80,
        keep_prompt: bool = False,
    ) -> int:
        return self._ask(
            viewer, lambda seq, now: SetVelocity(viewer.key, seq, now, x, z, heading, hold_frames, keep_prompt)
        )

    def pause(self, viewer: Viewer, paused: bool) -> int:
        viewer.set_paused(paused, self.clock.now())
        state = PlayState.PAUSED if paused else PlayState.PLAYING
        return self._ask(viewer, lambda seq, now: SetPlayState(viewer.key, seq, now, state))

    def seek(
        self, viewer: Viewer, start: StartPose | None = None, prior_rows: np.ndarray | None = None, frame: int = 0
    ) -> int:
        pose = start or StartPose()
        return self._ask(viewer, lambda seq, now: Seek(viewer.key, seq, now, pose, prior_rows, frame))

    def set_options(self, viewer: Viewer, **options: object) -> int:
        return self._ask(viewer, lambda seq, now: SetOptions(viewer.key, seq, now, **options))  # type: ignore[arg-type]

    def close(self, viewer: Viewer) -> None:
        seq = next(self._seqs)
        viewer.close_seqs.add(seq)
        self._askers[seq] = viewer
        self._carry(lambda now: self.engine.submit(Close(viewer.key, seq, now)))

    def report(self, viewer: Viewer) -> None:
        report = viewer.report(self.clock.now())
        self._carry(lambda now: self.engine.submit(report._replace(received_at=now)))

    def _ask(self, viewer: Viewer, event: Callable[[int, float], _Edit]) -> int:
        seq = next(self._seqs)
        viewer.asked.add(seq)
        self._askers[seq] = viewer
        self._carry(lambda now: self._submit(viewer, event(seq, now)))
        return seq

    def _submit(self, viewer: Viewer, event: Open | _Edit) -> None:
        refused = self.engine.submit(event)
        if refused is not None:
            viewer.take(refused, self.clock.now())

    def _carry(self, arrive: Callable[[float], object]) -> None:
        """Let something arrive after the delay; `arrive` is called with the time."""
        if not self._delay_s:
            arrive(self.clock.now())
        else:
            self._under_way.append((self.clock.now() + self._delay_s, arrive))

    def _let_arrive(self) -> None:
        while self._under_way and self._under_way[0][0] <= self.clock.now():
            arrived_at, arrive = self._under_way.popleft()
            arrive(arrived_at)

    # ---- time -------------------------------------------------------------------------------------------------------

    def step(self) -> StepReport:
        """Run one step of the engine; a step that denoises takes virtual time."""
        report = self.engine.step()
        self.reports.append(report)
        return report

    def tiers(self) -> Mapping[Priority, ServiceTier]:
        """The tier of each class as last reported; empty before the first report."""
        return next((report.tiers for report in reversed(self.reports) if report.tiers is not None), {})

    def run(self, seconds: float) -> None:
        """Run the engine and the viewers for so many virtual seconds."""
        end = self.clock.now() + seconds
        while self.clock.now() < end:
            self.report_playheads()
            if not self.step().rows:
                self.clock.advance(min(max(self.engine.idle_s(), 0.001), 0.05, max(end - self.clock.now(), 1e-6)))
        for viewer in self.viewers.values():
            viewer.play(self.clock.now())

    def run_until(self, holds: Callable[[], bool], limit_s: float = 10.0) -> None:
        end = self.clock.now() + limit_s
        while not holds():
            assert self.clock.now() < end, "the condition never came true"
            self.run(0.001)

    def report_playheads(self) -> None:
        now = self.clock.now()
        for key, viewer in self.viewers.items():
            due = viewer.buffered_to > 0 and viewer.closed is None and now >= self.next_report_at[key]
            if due and key not in self.silent:
                self.next_report_at[key] = now + self._report_every_s
                self.report(viewer)

    def deliver(self, outputs: Sequence[Output]) -> None:
        self.outputs += outputs
        arriving = [(self._addressee(output), output) for output in outputs]

        def arrive(now: float) -> None:
            for viewer, output in arriving:
                viewer.take(output, now)

        self._carry(arrive)

    def _addressee(self, output: Output) -> Viewer:
        """The viewer that made the request, if its handle has been reused since; else the one that has the handle."""
        asker = self._askers.get(output.event_seq) if isinstance(output, Outcome) else None
        return asker or self.viewers[output.session]

    def total(self, field: str) -> int:
        """The sum of a count, or of the lengths of a list, over all reports."""
        values = [getattr(report, field) for report in self.reports]
        return sum(value if isinstance(value, int) else len(value) for value in values)

    def check_finished(self) -> None:
        """Check what must hold once everything has been answered."""
        assert self.runner.breaches == []
        for viewer in self.viewers.values():
            assert viewer.outcomes.keys() == viewer.asked
            refused_openly = all(
                outcome.reason and outcome.message
                for outcome in viewer.outcomes.values()
                if outcome.code is not Code.OK
            )
            assert refused_openly


def crowd(num: int, config: EngineConfig | None = None, **fields: object) -> tuple[Stage, list[Viewer]]:
    """A stage with so many sessions, each with its own seed."""
    stage = Stage(config)
    return stage, [stage.open(handle, seed=handle, **fields) for handle in range(1, num + 1)]
