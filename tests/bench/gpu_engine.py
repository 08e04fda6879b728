"""The engine's table on a GPU at the released size: `python -m tests.bench.gpu_engine --out out/gpu --part served`.

First it steers the built-in model by constraints of every kind and by a velocity. The model that is measured has random
weights, so nothing has to be downloaded; only torch, numpy, psutil and this repository are needed. Each part ends
within ten minutes; the results of all parts in --out are compared with the goals. `--device cpu --tiny --quick` tries
the script without a GPU. The picture is drawn later, where matplotlib is installed: see tests.bench.engine_picture.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.loading import graphs_for
from tests.bench.engine import parser, settings
from tests.bench.engine_run import run
from tests.bench.engine_table import markdown, write
from tests.bench.gpu_goals import goals, reports_in
from tests.steered_jobs import MINI, all_kinds, played

PARTS: dict[str, tuple[str, ...]] = {
    "batches": (),
    "single": ("B0",),
    "served": ("B5",),
    "others": ("B1", "B2", "null"),
}
"""The contestants of each part. Every part also measures full batches, in both precisions."""


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The options. Exits with code 2 if there is no such device."""
    made = parser("python -m tests.bench.gpu_engine", (__doc__ or "").splitlines()[0])
    made.set_defaults(rows=128, precision="bfloat16", only=None, threads=1)  # as in an engine process on a GPU
    made.add_argument("--device", default="cuda", help="(default: %(default)s)")
    made.add_argument("--tiny", action="store_true", help="a model of a few thousand weights, to try the script")
    made.add_argument("--part", nargs="+", choices=PARTS, default=list(PARTS), help="(default: all)")
    made.add_argument("--no-graphs", action="store_true", help="call the layers one by one, without CUDA graphs")
    options = made.parse_args(arguments)
    if options.device.startswith("cuda") and not torch.cuda.is_available():
        made.error(f"--device {options.device}: torch finds no CUDA device; use --device cpu --tiny to try the script")
    return options


def steered(device: str) -> int:
    """Play windows steered by constraints of every kind and by a velocity. Returns how many.

    Raises AssertionError if a number is not finite.
    """
    model = load_checkpoint(MINI, device)
    runner = TorchRunner(model, "mini", graphs=graphs_for(device))
    with runner.recording_at_once():
        first = played(runner, all_kinds(model))
        results = first + played(runner, all_kinds(model, first))
    assert all(np.isfinite(result.frames).all() for result in results)
    return len(results)


def main() -> int:
    options = parse()
    print(f"{steered(options.device)} windows of the built-in model, steered in every way: all finite", flush=True)
    for part in options.part:
        begun_s = time.monotonic()
        options.only = options.only or PARTS[part]
        report = run(settings(options, "tiny" if options.tiny else "full", options.device))
        print(f"{part}, {time.monotonic() - begun_s:.0f} s:\n\n{markdown(report)}", flush=True)
        if options.out:
            write(report, options.out / (f"{part}-without-graphs" if options.no_graphs else part))
        options.only = None
    if options.out:
        print("\n".join(goals(reports_in(options.out))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
