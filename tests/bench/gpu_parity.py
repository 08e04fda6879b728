"""What a device computes against the processor, and in company against alone: `python -m tests.bench.gpu_parity`.

For the built-in model, in both precisions, with the layers called and replayed as graphs: windows of every kind of
constraint, and rows alone and in batches of 2 to 128. Prints a table; ends with 1 where a bound is broken. Needs torch,
numpy, psutil and this repository alone. `--device cpu` tries the script where there is no GPU.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.precision import PRECISIONS
from motiongen_server.engine.types import WindowJob, WindowResult
from motiongen_server.runner import TorchRunner
from tests.bench.engine_run import serving_runner
from tests.bench.machine import machine_facts
from tests.steered_jobs import MINI, all_kinds, played

COMPANIES = (2, 3, 5, 8, 24, 128)
FRAME_BOUND_M = {"float32": 0.02, "bfloat16": 0.1}
"""How far hips may be from where the processor has them in float32, in half of the windows: at ties of its rounding
codes of the tokenizer fall otherwise."""
COMPANY_BOUND = {"float32": 1e-4, "bfloat16": 0.05}
"""By how much a token may differ after a step: products of other sizes add in another order."""


@dataclass(frozen=True)
class Row:
    """One precision and one way of calling the layers.

    worst_m: the most that hips are from where the processor has them in float32, over all windows; median_m: half of
    them.
    company: the most that a token differs after a step, by the number of rows.
    """

    precision: str
    graphs: bool
    worst_m: float
    median_m: float
    company: dict[int, float]

    @property
    def holds(self) -> bool:
        within = self.median_m <= FRAME_BOUND_M[self.precision]
        return within and max(self.company.values()) <= COMPANY_BOUND[self.precision]


def windows(runner: TorchRunner, model: Model, before: Sequence[WindowResult]) -> list[WindowResult]:
    """First windows of every kind of constraint, and windows that go on from those that are given."""
    return [*played(runner, all_kinds(model)), *played(runner, all_kinds(model, before))]


def tokens_after_a_step(runner: TorchRunner, jobs: Sequence[WindowJob]) -> list[torch.Tensor]:
    ids = [job.job_id for job in jobs]
    runner.prepare(jobs)
    runner.denoise(ids)
    tokens = [runner.row(job_id).tokens.cpu() for job_id in ids]
    runner.discard(ids)
    return tokens


def in_company(runner: TorchRunner, jobs: Sequence[WindowJob]) -> dict[int, float]:
    """By the number of rows: how far the first rows' tokens are from what they are alone."""
    alone = [tokens_after_a_step(runner, [job])[0] for job in jobs[: COMPANIES[0]]]
    found = {}
    for count in COMPANIES:
        together = tokens_after_a_step(runner, jobs[:count])
        found[count] = max(float((one - other).abs().max()) for one, other in zip(together, alone, strict=False))
    return found


def measure(runner: TorchRunner, model: Model, expected: Sequence[WindowResult]) -> tuple[float, float]:
    """How far the hips of windows are from where they should be, in metres: the worst window, and the median."""
    found = windows(runner, model, expected[: len(expected) // 2])
    apart = [float(np.abs(one.frames - other.frames)[:, :3].max()) for one, other in zip(found, expected, strict=True)]
    return max(apart), float(np.median(apart))


def measured_on(device: str) -> list[Row]:
    """Both precisions, called and replayed, against float32 on the processor."""
    reference = load_checkpoint(MINI, "cpu")
    begun = played(TorchRunner(reference, "mini"), all_kinds(reference))
    expected = [*begun, *played(TorchRunner(reference, "mini"), all_kinds(reference, begun))]
    kinds = all_kinds(reference, begun)
    jobs = [replace(kinds[number % len(kinds)], job_id=number + 1, seed=number) for number in range(COMPANIES[-1])]
    model = load_checkpoint(MINI, device)
    rows = []
    for precision in PRECISIONS:
        for graphs in (False, True):
            runner = serving_runner(model, "mini", precision, graphs)
            rows.append(Row(precision, graphs, *measure(runner, model, expected), in_company(runner, jobs)))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.gpu_parity", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--device", default="cuda", help="(default: %(default)s)")
    options = parser.parse_args()
    print("\n".join(f"{key}: {value}" for key, value in machine_facts().items()))
    companies = " / ".join(map(str, COMPANIES))
    print(f"\n| precision | layers | hips apart, worst / median | tokens apart in company of {companies} | holds |")
    print("|---|---|---:|---:|---|")
    rows = measured_on(options.device)
    for row in rows:
        company = " / ".join(f"{value:.1e}" for value in row.company.values())
        layers, apart = "replayed" if row.graphs else "called", f"{row.worst_m:.4f} / {row.median_m:.4f} m"
        print(f"| {row.precision} | {layers} | {apart} | {company} | {'yes' if row.holds else 'no'} |")
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
