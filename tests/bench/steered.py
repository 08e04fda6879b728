"""How characters move under a stick that is sent continuously: `python -m tests.bench.steered [--characters 3]`.

Characters of the built-in model are steered ten times a second, by the real engine in virtual time: the model computes,
while the engine's clock advances by what its calls cost on another machine. The sticks are typical of players: straight
on, in a circle, weaving, about-face, and stop and go, with the body facing the way it goes; sideways, backwards, and in
a circle, with a fixed heading; and backwards faster than the body can step, then ahead. The shown motion is measured as
in the evaluation.
"""

from __future__ import annotations

import argparse
import heapq
import logging
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple

import numpy as np
import torch

from motiongen_ardy.capabilities import read_capabilities
from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import model_folder
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.evaluate.measures.feet import glide_share, slowest_foot
from motiongen_ardy.evaluate.measures.smooth import accelerations, seam_jumps
from motiongen_ardy.text import load_text_encoder
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.types import (
    Chunk,
    Direction,
    Event,
    Float32Array,
    Gait,
    Open,
    Output,
    PlanCause,
    PlanNotice,
    Playhead,
    Priority,
    Prompt,
    SessionKey,
    SessionSpec,
    SetVelocity,
)
from motiongen_server.runner.outputs import JOINT_POSITIONS
from motiongen_server.runner.torch_runner import TorchRunner
from tests.bench.costed_runner import Costs, TimedRunner, VirtualClock
from tests.bench.models import BUILT_IN
from tests.bench.playback import Playback

_STICK_HZ, _REPORT_HZ, _WAY_S = 10.0, 4.0, 0.012
_SPEED_M_S, _HOLD_FRAMES = 1.4, 10
_STAND = "a person stands still"
_STEERED_FROM_S = 2.0
"""Until this time they stand."""
_TOO_FAST_S = 3.0


class Tilt(NamedTuple):
    """How a stick is tilted: its angle from z to x, its share of full speed, and the angle to face.

    facing: None for the direction of movement.
    """

    angle: float
    share: float = 1.0
    facing: float | None = None


Stick = Callable[[float], Tilt]
"""A stick's tilt at a time in seconds."""

STICKS: dict[str, Stick] = {
    "straight on": lambda _: Tilt(0.0),
    "in a circle": lambda time_s: Tilt(0.8 * time_s),
    "weaving": lambda time_s: Tilt(math.sin(2.0 * time_s)),
    "about-face": lambda time_s: Tilt(math.pi * (int(time_s / 4.0) % 2)),
    "stop and go": lambda time_s: Tilt(0.0, int(time_s / 2.0) % 2),
    "sideways": lambda _: Tilt(math.pi / 2, facing=0.0),
    "backwards": lambda _: Tilt(math.pi, facing=0.0),
    "all round, facing one way": lambda time_s: Tilt(0.8 * time_s, facing=0.0),
    "too fast, then ahead": lambda time_s: Tilt(math.pi, 1.7, 0.0) if time_s < _TOO_FAST_S else Tilt(0.0),
}


class Screen:
    """What a character's player sees. rows: shown rows, by frame; seams: first frames of plans caused by the stick."""

    def __init__(self, fps: int) -> None:
        self.playback = Playback(fps)
        self._rows: list[Float32Array] = []
        self._seams: list[int] = []

    def hear(self, output: Output, now: float) -> None:
        self.playback.hear(output, now)
        match output:
            case PlanNotice(valid_from=first, cause=cause):
                del self._rows[first:]
                self._seams = [seam for seam in self._seams if seam < first]
                if cause is PlanCause.EDIT:
                    self._seams.append(first)
            case Chunk():
                self._rows += list(output.rows)

    def shown(self, now: float) -> tuple[Float32Array, list[int]]:
        """The rows that were shown, and the frames at which plans meet in them."""
        end = self.playback.frame_at(now)
        return np.stack(self._rows[:end]), [seam for seam in self._seams if seam < end]


class Players:
    """The engine's inbox: characters that open one after another and are steered. `deliver` takes what they see."""

    def __init__(
        self, specs: Sequence[SessionSpec], sticks: Sequence[Stick], speed_m_s: float, fps: int, clock: VirtualClock
    ) -> None:
        """speed_m_s: at full tilt."""
        self._speed_m_s = speed_m_s
        self.screens = {spec.session: Screen(fps) for spec in specs}
        self._clock, self._began_at = clock, clock.now()
        self._order, self._seq = count(), count(2)
        self._due: list[tuple[float, int, Callable[[float], Event], float]] = []
        for index, (spec, stick) in enumerate(zip(specs, sticks, strict=True)):
            at = 0.017 * index
            self._later(at, self._opens(spec), math.inf)
            self._later(at + 0.3, self._reports(spec.session), 1.0 / _REPORT_HZ)
            self._later(at + _STEERED_FROM_S, self._steers(spec.session, stick), 1.0 / _STICK_HZ)

    def _later(self, at_s: float, make: Callable[[float], Event], every_s: float) -> None:
        heapq.heappush(self._due, (self._began_at + at_s, next(self._order), make, every_s))

    @staticmethod
    def _opens(spec: SessionSpec) -> Callable[[float], Event]:
        return lambda at: Open(spec, 1, at)

    def _reports(self, key: SessionKey) -> Callable[[float], Event]:
        def make(at: float) -> Event:
            playback = self.screens[key].playback
            shown, held = playback.frame_at(at), playback.buffered_to
            return Playhead(key, 0, at, shown, held, playback.underruns(), 0.01)

        return make

    def _steers(self, key: SessionKey, stick: Stick) -> Callable[[float], Event]:
        def make(at: float) -> Event:
            tilt = stick(at - self._began_at - _STEERED_FROM_S)
            speed = tilt.share * self._speed_m_s
            seq = next(self._seq)
            self.screens[key].playback.meant(seq, at)
            x, z = speed * math.sin(tilt.angle), speed * math.cos(tilt.angle)
            return SetVelocity(key, seq, at, x, z, tilt.facing, _HOLD_FRAMES)

        return make

    @property
    def now(self) -> float:
        return self._clock.now()

    def put(self, event: Event) -> bool:
        raise NotImplementedError(f"events come from the script alone, not {event}")

    def take_all(self) -> list[Event]:
        arrived = []
        while self._due and self._due[0][0] + _WAY_S <= self._clock.now():
            at, _, make, every_s = heapq.heappop(self._due)
            arrived.append(make(at))
            if every_s < math.inf:
                self._later(at + every_s - self._began_at, make, every_s)
        return arrived

    def wait(self, timeout_s: float) -> None:
        next_at = self._due[0][0] + _WAY_S if self._due else self._clock.now() + timeout_s
        self._clock.time_s += max(1e-6, min(timeout_s, next_at - self._clock.now()))

    def ring(self) -> None:
        """Does nothing: nothing waits on another thread."""

    def deliver(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            self.screens[output.session].hear(output, self._clock.now() + _WAY_S)


@dataclass(frozen=True)
class Crew:
    """A model that computes, and its characters' prompts. gaits: for velocities; prompt: before any velocity."""

    runner: TorchRunner
    skeleton: Skeleton
    gaits: tuple[Gait, ...]
    prompt: Prompt

    @classmethod
    def built_in(cls) -> Crew:
        folder = model_folder(BUILT_IN)
        model = load_checkpoint(folder)
        encoder = load_text_encoder("static", model.config.denoiser.text_dim)
        ways = read_capabilities(folder).locomotion
        vectors = np.asarray(encoder.encode([_STAND, *(way.text for way in ways)]), np.float32)
        gaits = tuple(
            Gait(way.name, way.text, way.from_mps, Direction(way.quarter), vector)
            for way, vector in zip(ways, vectors[1:], strict=True)
        )
        return cls(TorchRunner(model, BUILT_IN), model.skeleton, gaits, Prompt(1, None, None, _STAND, vectors[0]))

    def spec(self, number: int, num_steps: int) -> SessionSpec:
        facts = self.runner.facts
        return SessionSpec(
            SessionKey(1, number), number, facts.model_id, Priority.HERO, facts.horizon, num_steps, facts.guidance,
            prompts=(self.prompt,), gaits=self.gaits,
        )  # fmt: skip


def play(
    crew: Crew, sticks: Sequence[Stick], num_steps: int, seconds: float, costs: Costs, speed_m_s: float = _SPEED_M_S
) -> Players:
    """Play a character for each stick. speed_m_s: at full tilt."""
    clock = VirtualClock()
    specs = [crew.spec(number, num_steps) for number in range(len(sticks))]
    players = Players(specs, sticks, speed_m_s, crew.runner.facts.fps, clock)
    config = EngineConfig(admit_load=(1e6,) * 4, degrade=False)
    engine = Engine(TimedRunner(crew.runner, clock, costs), clock, players.deliver, config, inbox=players)
    ends_at = clock.now() + seconds
    while clock.now() < ends_at:
        if not engine.step().rows:
            players.wait(min(engine.idle_s(), 0.05))
    return players


def measure(
    crew: Crew, screen: Screen, now: float, from_s: float = _STEERED_FROM_S
) -> tuple[float, float, float, float]:
    """Measure what was shown from a time on, while the character was steered.

    Returns the slowest foot's speed divided by the root's; the share of frames in which all feet glide; the 99th
    percentile of accelerations, m/s2; the 95th percentile of the jumps in acceleration where plans meet.
    """
    fps = crew.runner.facts.fps
    rows, seams = screen.shown(now)
    first = int(from_s * fps)
    positions = torch.from_numpy(crew.runner.outputs([JOINT_POSITIONS], rows)).unflatten(1, (-1, 3))[first:]
    inside = [seam - 1 - first for seam in seams if seam > first]
    jumps = seam_jumps(positions, inside, fps)[:, 2]
    return (
        slowest_foot(crew.skeleton, positions, fps),
        glide_share(crew.skeleton, positions, fps),
        float(accelerations(positions, fps).quantile(0.99)),
        float(jumps.quantile(0.95)) if len(jumps) else math.nan,
    )


def _percentiles_ms(seconds: Sequence[float]) -> str:
    p50, p99 = 1000 * np.percentile(seconds, [50, 99])
    return f"{p50:.0f} / {p99:.0f}"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.steered", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sticks", nargs="+", choices=STICKS, default=list(STICKS))
    parser.add_argument("--characters", type=int, default=2, help="for each stick (default: %(default)s)")
    parser.add_argument("--speed", type=float, default=_SPEED_M_S, help="at full tilt of the stick, m/s (%(default)s)")
    parser.add_argument("--steps", type=int, default=4, help="denoising steps of a window")
    parser.add_argument("--seconds", type=float, default=14.0)
    parser.add_argument("--slower", type=float, default=0.5, help="factor on the time of calls, 1: idle machine")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    torch.set_num_threads(1)
    crew = Crew.built_in()
    print(
        "| stick | edits, ms | shown, ms | slowest foot | glides, worst | accelerations, m/s2 | at joins, m/s2 | late |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    names = [name for name in options.sticks for _ in range(options.characters)]
    sticks = [STICKS[name] for name in names]
    players = play(crew, sticks, options.steps, options.seconds, Costs(slower=options.slower), options.speed)
    screens = list(players.screens.values())
    figures = [measure(crew, screen, players.now) for screen in screens]
    for name in options.sticks:
        of_stick = [index for index, each in enumerate(names) if each == name]
        foot, glide, acceleration, jump = np.nanmean([figures[index] for index in of_stick], axis=0)
        worst = max(figures[index][1] for index in of_stick)
        playbacks = [screens[index].playback for index in of_stick]
        came = _percentiles_ms([each for playback in playbacks for each in playback.latencies_s])
        shown = _percentiles_ms([each for playback in playbacks for each in playback.shown_after_s])
        late = sum(playback.underruns() for playback in playbacks)
        glides = f"{glide:.1%}, {worst:.1%}"
        print(f"| {name} | {came} | {shown} | {foot:.3f} | {glides} | {acceleration:.0f} | {jump:.0f} | {late} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
