"""What each speed-up is worth by itself: `python -m tests.bench.levers`.

First one transformer stack of the denoiser on many sequences, computed in different ways; then the three calls of the
runner, with and without the speed-ups. Everything in one run, medians of interleaved repetitions.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor, nn

from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed.stack import Group, PackedStack
from motiongen_server.engine.types import Float32Array
from motiongen_server.ops.memory import keep_freed_memory
from motiongen_server.runner import TorchRunner
from tests.bench.clocks import WallClock
from tests.bench.flops import stack_flops
from tests.bench.machine import machine_facts, usable_cores
from tests.bench.models import BUILT_IN, bench_model
from tests.bench.offline import offline_rate
from tests.bench.plain_runner import PlainRunner
from tests.bench.products import product_flops_per_s

SEQUENCES, LENGTH = 64, 17  # 32 rows of two passes: prefix of 3, history of 4, horizon of 10
ROWS = (1, 8, 32, 64)


def stack_ways(model: Model, compile_too: bool) -> dict[str, Callable[[], Tensor]]:
    """Ways to compute one stack on (SEQUENCES, LENGTH) vectors; all but int8 give the same up to their precision."""
    stack = model.denoiser.root_model.seqTransEncoder
    width = model.config.denoiser.transformer.width
    padded = torch.randn(SEQUENCES, LENGTH, width)
    packed = padded.flatten(0, 1)
    groups = [Group(0, SEQUENCES, LENGTH)]
    in_float32, in_bfloat16 = PackedStack(stack, torch.float32), PackedStack(stack, torch.bfloat16)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch calls its own quantisation old; there is no other without a package
        in_int8 = torch.ao.quantization.quantize_dynamic(stack, {nn.Linear}, dtype=torch.qint8)

    def autocast() -> Tensor:
        with torch.autocast("cpu", torch.bfloat16):
            result: Tensor = stack(padded)
        return result

    ways: dict[str, Callable[[], Tensor]] = {
        "torch, float32": lambda: stack(padded),
        "torch, bfloat16 (autocast)": autocast,
        "torch, int8 (dynamic)": lambda: in_int8(padded),
        "packed, float32": lambda: in_float32(packed, groups),
        "packed, bfloat16": lambda: in_bfloat16(packed, groups),
    }
    if compile_too:
        compiled = torch.compile(stack)
        ways["torch.compile, float32"] = lambda: compiled(padded)
    return ways


def measure_stack(model: Model, seconds: float, compile_too: bool) -> dict[str, dict[str, float]]:
    """By way: milliseconds, and the rate of arithmetic."""
    ways = stack_ways(model, compile_too)
    times: dict[str, list[float]] = {name: [] for name in ways}
    for way in ways.values():
        way()
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        for name, way in ways.items():
            begun = time.perf_counter()
            way()
            times[name].append(time.perf_counter() - begun)
    work = SEQUENCES * stack_flops(model.config.denoiser.transformer, LENGTH)
    return {name: {"ms": 1e3 * median(taken), "GFLOP/s": work / median(taken) / 1e9} for name, taken in times.items()}


def measure_runners(model: Model, embeddings: Sequence[Float32Array], seconds: float) -> dict[str, dict[str, float]]:
    """By runner and rows: milliseconds of a batch's prepare, one step and decode, and windows a second."""
    runners = {
        "plain, float32": (PlainRunner(model, "bench"), False),
        "packed, float32, encoded again": (TorchRunner(model, "bench"), False),
        "packed, float32": (TorchRunner(model, "bench"), True),
        "packed, bfloat16": (TorchRunner(model, "bench", precision=torch.bfloat16), True),
    }
    figures = {}
    for rows in ROWS:
        for name, (runner, keep_tokens) in runners.items():
            rate = offline_rate(runner, rows, 4, embeddings, seconds, WallClock(), keep_tokens=keep_tokens)
            figures[f"{name}, {rows} rows"] = {
                "prepare ms": 1e3 * rate.prepare_s,
                "step ms": 1e3 * rate.step_s,
                "decode ms": 1e3 * rate.decode_s,
                "windows/s": rate.windows_per_s,
            }
    return figures


def print_table(console: Console, title: str, figures: dict[str, dict[str, float]]) -> None:
    table = Table("", *next(iter(figures.values())), title=title)
    for name, values in figures.items():
        table.add_row(name, *(f"{value:.1f}" for value in values.values()))
    console.print(table)


@torch.inference_mode()
def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.levers", description=__doc__)
    parser.add_argument("--model", default=BUILT_IN, help="built-in model or checkpoint folder (default %(default)s)")
    parser.add_argument("--seconds", type=float, default=2.0, help="for each row of a table (default %(default)s)")
    parser.add_argument("--compile", action="store_true", help="torch.compile too; it needs a C++ compiler")
    parser.add_argument(
        "--return-memory", action="store_true", help="give freed memory back, as a process does by itself"
    )
    parser.add_argument("--out", type=Path, help="folder for levers.json")
    arguments = parser.parse_args()
    torch.set_num_threads(usable_cores())
    if not arguments.return_memory:
        keep_freed_memory()
    facts, console = machine_facts(), Console()
    for name, fact in facts.items():
        console.print(f"{name}: {fact}", highlight=False)
    peaks = {
        name: product_flops_per_s("cpu", dtype, 1.0, WallClock()) / 1e9
        for name, dtype in (("float32", torch.float32), ("bfloat16", torch.bfloat16))
    }
    console.print(f"matrix product, GFLOP/s: {', '.join(f'{name} {rate:.0f}' for name, rate in peaks.items())}")
    loaded = bench_model(arguments.model)
    stack = measure_stack(loaded.model, 5 * arguments.seconds, arguments.compile)
    print_table(console, f"one stack, {SEQUENCES} sequences of {LENGTH}", stack)
    runners = measure_runners(loaded.model, loaded.embeddings, arguments.seconds)
    print_table(console, "the runner's calls, 4 steps", runners)
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        result = {"machine": facts, "matrix product GFLOP/s": peaks, "stack": stack, "runner": runners}
        (arguments.out / "levers.json").write_text(json.dumps(result, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
