"""Measures all figures of the engine's table in one run, one after another."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace

import torch

from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed.graphs import sizes_up_to
from motiongen_ardy.model.precision import PRECISIONS
from motiongen_server.engine.scheduling.warm_up import warm_up
from motiongen_server.ops.memory import keep_freed_memory, settled_objects
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.loading import graphs_for
from tests.bench.clocks import BenchClock, ProcessorClock, WallClock
from tests.bench.contest import Contest, Standing, contest_config
from tests.bench.crowd import Habits
from tests.bench.flops import Pass, decode_flops, step_flops
from tests.bench.machine import machine_facts
from tests.bench.models import BenchModel, bench_model
from tests.bench.offline import HISTORY_FRAMES, OfflineRate, offline_rate
from tests.bench.products import product_flops_per_s, waits_for
from tests.bench.trial import Effort

FULL_SIZE_BATCHES = (1, 8, 32)


@dataclass(frozen=True)
class Settings:
    """What to measure: contestants by name, with one model on one device in one precision.

    graphs: whether layers are replayed as CUDA graphs, on a GPU.
    """

    model: str
    device: str
    precision: str
    names: tuple[str, ...]
    num_steps: int
    max_rows: int
    threads: int
    effort: Effort
    processor_time: bool = False
    graphs: bool = True

    @property
    def clock(self) -> BenchClock:
        """A new clock of the kind these settings ask for."""
        return ProcessorClock() if self.processor_time else WallClock()


@dataclass(frozen=True)
class Ceiling:
    """Full batches of the runner that serves. product_flops_per_s: the machine's best matrix product in this run.

    window_flops, step_flops: useful FLOPs of a window, and of one denoising step of a window.
    """

    model: str
    precision: str
    rate: OfflineRate
    window_flops: int
    step_flops: int
    product_flops_per_s: float

    @property
    def efficiency(self) -> float:
        """Useful FLOPs of whole windows, relative to the matrix product."""
        return self.window_flops * self.rate.windows_per_s / self.product_flops_per_s

    @property
    def step_efficiency(self) -> float:
        """Useful FLOPs of denoising steps alone, relative to the matrix product."""
        return self.step_flops * self.rate.batch / self.rate.step_s / self.product_flops_per_s


@dataclass(frozen=True)
class Report:
    """All measurements, and the machine and settings they were made with."""

    facts: dict[str, str]
    settings: Settings
    habits: Habits
    ceilings: tuple[Ceiling, ...]
    standings: tuple[Standing, ...]


def run(settings: Settings, full_size: bool = False) -> Report:
    """Measure everything, with progress messages on stderr."""
    torch.set_num_threads(settings.threads)
    keep_freed_memory()  # as the server does
    facts = {
        **machine_facts(),
        "threads of torch": str(torch.get_num_threads()),
        "OMP_WAIT_POLICY": os.environ.get("OMP_WAIT_POLICY", "not set"),
    }
    if settings.device != "cpu":
        facts["device"] = torch.cuda.get_device_name(settings.device)
        facts["layers"] = "replayed as CUDA graphs" if settings.graphs else "called one by one"
    chosen = bench_model(settings.model, settings.device)
    habits = Habits(num_steps=settings.num_steps)
    served = {
        precision: serving_runner(chosen.model, chosen.name, precision, settings.graphs)
        for precision in dict.fromkeys((settings.precision, "bfloat16"))
    }
    contest = Contest(
        model=chosen.model,
        embeddings=chosen.embeddings,
        runner=served[settings.precision],
        bf16_runner=served["bfloat16"],
        habits=habits,
        config=contest_config(settings.max_rows),
        effort=settings.effort,
        clock=settings.clock,
        bf16=settings.precision == "bfloat16",
    )
    if settings.device != "cpu" and settings.graphs:
        say("graphs")
        for one in served.values():
            with one.recording_at_once():
                warm_up(one, sizes_up_to(settings.max_rows), HISTORY_FRAMES)
    say("full batches")
    batches = sorted({settings.max_rows, 2 * settings.max_rows})
    ceilings = [
        ceiling(chosen, one, replace(settings, precision=precision), batch, settings.effort.offline_s)
        for precision, one in served.items()
        for batch in batches
    ]
    with settled_objects():  # as the server does; otherwise garbage collections stop everything for up to 0.1 s
        standings = [contest.measure(name, say) for name in settings.names]
    if full_size:
        ceilings += full_size_ceilings(settings)
    return Report(facts, settings, habits, tuple(ceilings), tuple(standings))


def serving_runner(model: Model, name: str, precision: str, graphs: bool = True) -> TorchRunner:
    """graphs: whether layers are replayed as CUDA graphs, on a GPU."""
    device = str(model.representation.stats.mean.device)
    replayed = graphs_for(device) if graphs else None
    return TorchRunner(model, name, precision=PRECISIONS[precision], graphs=replayed)


def ceiling(
    chosen: BenchModel,
    runner: TorchRunner,
    settings: Settings,
    batch: int,
    seconds: float,
    steps_run: int | None = None,
) -> Ceiling:
    """Measure full batches of one size."""
    rate = offline_rate(
        runner,
        batch,
        settings.num_steps,
        chosen.embeddings,
        seconds=seconds,
        clock=settings.clock,
        steps_run=steps_run,
        synchronize=waits_for(settings.device),
    )
    config, history_tokens = chosen.model.config, HISTORY_FRAMES // chosen.model.config.patch
    one_step = rate.passes * step_flops(config, Pass(history_tokens))
    decoding = decode_flops(config, chosen.model.skeleton.feature_dim - 5, history_tokens)
    precision = PRECISIONS[settings.precision]
    peak = product_flops_per_s(settings.device, precision, settings.effort.product_s, settings.clock)
    window = settings.num_steps * one_step + decoding
    return Ceiling(chosen.name, settings.precision, rate, window, one_step, peak)


def full_size_ceilings(settings: Settings) -> list[Ceiling]:
    """Measure the released size with random weights: a few steps of each batch size, in both precisions."""
    chosen = bench_model("full", settings.device)
    found = []
    for precision in PRECISIONS:
        runner = serving_runner(chosen.model, chosen.name, precision)
        for batch in FULL_SIZE_BATCHES:
            say(f"{chosen.name}, {precision}, batches of {batch}")
            found.append(ceiling(chosen, runner, replace(settings, precision=precision), batch, 0.0, steps_run=2))
    return found


def say(what: str) -> None:
    print(what, file=sys.stderr, flush=True)
