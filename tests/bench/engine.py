"""Compare the engine with simpler ones, in one run: `python -m tests.bench.engine --out out/bench`.

Characters play in real time, in this process, from what the engine delivers, without network or service. For each
engine, this finds the most characters with under 1 % of frames missing and, at 70 % of that, measures how soon an edit
shows. For comparison it measures the ceiling, which is full batches without real time, and the machine's own matrix
product. On a machine that is also used by others, --processor-time measures what one dedicated core would do.
Prints a table, and with --out writes engine.json, engine.md and engine.png.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from motiongen_server.devices import usable_cores
from tests.bench.contest import NAMES
from tests.bench.engine_run import Settings, run
from tests.bench.engine_table import as_json, markdown, write
from tests.bench.models import BUILT_IN
from tests.bench.trial import QUICK, Effort


def parser(prog: str, description: str) -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(prog=prog, description=description)
    made.add_argument("--out", type=Path, help="folder to write to (default: print only)")
    made.add_argument("--quick", action="store_true", help="short trials, for a rough result")
    made.add_argument("--only", nargs="+", choices=NAMES, default=list(NAMES), help="rows to measure (default: all)")
    made.add_argument("--seconds", type=float, help="measuring time of each trial")
    made.add_argument("--steps", type=int, default=4, help="denoising steps (default: %(default)s)")
    made.add_argument("--rows", type=int, default=64, help="most rows per step (default: %(default)s)")
    made.add_argument("--precision", choices=("float32", "bfloat16"), default="float32", help="of matrix products")
    made.add_argument("--threads", type=int, default=usable_cores(), help="torch's (default: one for each core)")
    made.add_argument(
        "--processor-time", action="store_true", help="measure as on one dedicated core, however busy the machine"
    )
    return made


def settings(options: argparse.Namespace, model: str, device: str) -> Settings:
    effort = QUICK if options.quick else Effort()
    if options.seconds is not None:
        effort = effort.lasting(options.seconds)
    return Settings(
        model=model,
        device=device,
        precision=options.precision,
        names=tuple(options.only),
        num_steps=options.steps,
        max_rows=options.rows,
        threads=1 if options.processor_time else options.threads,
        effort=effort,
        processor_time=options.processor_time,
        graphs=not getattr(options, "no_graphs", False),
    )


def main() -> int:
    made = parser("python -m tests.bench.engine", (__doc__ or "").splitlines()[0])
    made.add_argument("--model", default=BUILT_IN, help='checkpoint folder, "full" or "tiny" (default: %(default)s)')
    made.add_argument("--device", default="cpu", help="(default: %(default)s)")
    made.add_argument("--full-size", action="store_true", help="also batches of the released size, random weights")
    options = made.parse_args()
    report = run(settings(options, options.model, options.device), options.full_size)
    print(markdown(report))
    if options.out:
        from tests.bench.engine_picture import draw

        write(report, options.out)
        draw(as_json(report), options.out / "engine.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
