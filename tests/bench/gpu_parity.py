"""Compare a device with the CPU, and rows in batches with the same rows alone: `python -m tests.bench.gpu_parity`.

For the built-in model, in both precisions, with the layers called and replayed as graphs: windows of every kind of
constraint, and rows alone and in batches of 2 to 128. Prints a table; exits with code 1 if a bound is broken. Needs
only torch, numpy, psutil and this repository. `--device cpu` tries the script without a GPU.
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
"""How far hips may be from those that the CPU computes in float32, as a median over windows: single windows may differ
more, because the tokenizer's rounding to codes falls differently at ties."""
COMPANY_BOUND = {"float32": 1e-4, "bfloat16": 0.05}
"""How much a token may differ after a step: matrix products of other sizes add in another order."""


@dataclass(frozen=True)
class Row:
    """One precision and one way of calling the layers.

    worst_m, median_m: how far hips are from those that the CPU computes in float32, over all windows.
    company: the largest difference of a token after a step, by the number of rows.
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
    """First windows with every kind of constraint, and windows that continue the given ones."""
    return [*played(runner, all_kinds(model)), *played(runner, all_kinds(model, before))]


def tokens_after_a_step(runner: TorchRunner, jobs: Sequence[WindowJob]) -> list[torch.Tensor]:
    ids = [job.job_id for job in jobs]
    runner.prepare(jobs)
    runner.denoise(ids)
    tokens = [runner.row(job_id).tokens.cpu() for job_id in ids]
    runner.discard(ids)
    return tokens


def in_company(runner: TorchRunner, jobs: Sequence[WindowJob]) -> dict[int, float]:
    """By the number of rows: how far the tokens of the first rows are from those of the same rows alone."""
    alone = [tokens_after_a_step(runner, [job])[0] for job in jobs[: COMPANIES[0]]]
    found = {}
    for count in COMPANIES:
        together = tokens_after_a_step(runner, jobs[:count])
        found[count] = max(float((one - other).abs().max()) for one, other in zip(together, alone, strict=False))
    return found


def measure(runner: TorchRunner, model: Model, expected: Sequence[WindowResult]) -> tuple[float, float]:
    """How far the windows' hips are from the expected ones, in metres: worst window, and median."""
    found = windows(runner, model, expected[: len(expected) // 2])
    apart = [float(np.abs(one.frames - other.frames)[:, :3].max()) for one, other in zip(found, expected, strict=True)]
    return max(apart), float(np.median(apart))


def measured_on(device: str) -> list[Row]:
    """Both precisions, called and replayed, compared with float32 on the CPU."""
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
