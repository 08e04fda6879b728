"""`python -m tests.bench.fuzz_edge`: fuzz stream messages, requests for clips and saved sessions with libFuzzer.

Needs atheris, which `make fuzz` installs. Each target of `tests.bench.fuzz_targets` runs in its own process for so many
seconds, guided by code coverage. Anything but a refusal of the kind that the reader promises is printed, ends the
target, and makes the exit code 1.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile

TARGETS = ("stream", "clip", "record")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.fuzz_edge", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of each target (default: %(default)s)")
    parser.add_argument("--only", choices=TARGETS, help="run this target alone")
    asked = parser.parse_args()
    failed = False
    for name in TARGETS if asked.only is None else [asked.only]:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "tests.bench.fuzz_targets", name, str(asked.seconds), folder]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        said = done.stderr.splitlines() + done.stdout.splitlines()
        count = next((line.rpartition(":")[2].strip() for line in said if "number_of_executed_units" in line), "?")
        reached = [line.split("cov: ")[1].split(" ")[0] for line in said if "cov: " in line]
        print(f"{name:8} {count:>9} inputs, {reached[-1] if reached else '?'} branches, exit code {done.returncode}")
        if done.returncode:
            failed = True
            print("\n".join(said[-40:]))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
