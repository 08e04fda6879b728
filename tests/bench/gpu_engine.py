"""The engine's table on a GPU at the released size: `python -m tests.bench.gpu_engine --out out/gpu`.

Random weights, so nothing has to be downloaded; needs torch, numpy and this repository alone. `--device cpu --tiny`
tries the script where there is no GPU. The picture is drawn later, where matplotlib is: see tests.bench.engine_picture.
"""

from __future__ import annotations

import sys

import torch

from tests.bench.engine import parser, settings
from tests.bench.engine_run import run
from tests.bench.engine_table import markdown, write


def main() -> int:
    made = parser("python -m tests.bench.gpu_engine", (__doc__ or "").splitlines()[0])
    made.set_defaults(rows=128, precision="bfloat16")
    made.add_argument("--device", default="cuda", help="(default: %(default)s)")
    made.add_argument("--tiny", action="store_true", help="a model of a few thousand weights: does the script run")
    options = made.parse_args()
    if options.device.startswith("cuda") and not torch.cuda.is_available():
        made.error(f"--device {options.device}: torch finds no CUDA device; with --device cpu --tiny the script runs")
    report = run(settings(options, "tiny" if options.tiny else "full", options.device))
    print(markdown(report))
    if options.out:
        write(report, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
