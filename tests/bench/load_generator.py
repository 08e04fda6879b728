"""How many characters one core of motiongen-load plays: `python -m tests.bench.load_generator --characters 2000`.

The crowd plays on the null server, whose engine computes nothing, by one process of the C++ program and, with --python,
also by Python processes. A row each: the cores that the load took, whether it was late itself (then its figures do not
count), and what the server missed. The C++ is built as the tests build it (-O1).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from motiongen_tools.cli import run
from tests.bench.client_cost import UNBOUNDED
from tests.bench.machine import busy_share, machine_facts
from tests.bench.null_process import NULL_SERVER, SETTINGS, server_process
from tests.cpp.building import build

VOID = 3


def play(characters: int, seconds: int, out: Path, *program: str) -> dict[str, Any]:
    """The report of one run. Raises SystemExit if there is none."""
    with server_process(NULL_SERVER, *SETTINGS, *UNBOUNDED) as server:
        load = ["--server", server.address, "--scenario", "crowd", "--characters", str(characters)]
        code = run(["bench", *load, "--seconds", str(seconds), "--seed", "1", "--out", str(out), *program])
    if code not in (0, VOID):
        sys.exit(code)
    document: dict[str, Any] = json.loads((out / "result.json").read_text(encoding="utf-8"))["result"]
    return document


def row(told: dict[str, Any]) -> str:
    generator, figures = told["generator"], told["figures"]["all"]
    lag_ms = max(generator[f"{what}_ms"]["p99"] for what in ("send_lag", "loop_lag"))
    return (
        f"| {generator['program']} | {told['load']['characters']} | {sum(generator['cores']):.2f} "
        f"| {figures['frames_per_s']:.0f} | {figures['miss_ratio']:.2%} | {lag_ms:.1f} "
        f"| {'yes' if told['void'] else 'no'} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.load_generator", description=__doc__)
    parser.add_argument("--characters", type=int, nargs="+", default=[2000], help="at once (default: %(default)s)")
    parser.add_argument("--seconds", type=int, default=10, help="how long to measure (default: %(default)s)")
    parser.add_argument("--python", action="store_true", help="also play with Python processes")
    options = parser.parse_args()
    settings = ("-DMOTIONGEN_TESTS=ON", "-DMOTIONGEN_EXAMPLES=ON")
    program = build("test", *settings, targets=("motiongen-load",)) / "load" / "motiongen-load"
    share, rows = busy_share(), []
    with tempfile.TemporaryDirectory() as folder:
        for characters in options.characters:
            rows.append(row(play(characters, options.seconds, Path(folder), "--program", str(program))))
            if options.python:
                rows.append(row(play(characters, options.seconds, Path(folder))))
    print("| played by | characters | cores of the load | frames/s | missed | late by, p99 ms | void |")
    print("|---|---:|---:|---:|---:|---:|---|", *rows, sep="\n")
    print("", *(f"- {name}: {value}" for name, value in machine_facts().items()), sep="\n")
    print(f"- others used: {share():.0%} of the machine meanwhile")
    return 0


if __name__ == "__main__":
    sys.exit(main())
