"""All scenarios of `motiongen bench` in one table: `python -m tests.bench.scenario_table --seeds 1 2 3 --seconds 60`.

A server is started for every run; load and server share the machine. The runs of one scenario follow each other: each
precision, and with --before COMMIT each revision, with its own load generator and server but the scenario files of this
checkout. Prints the table as it grows, with facts about the machine, and writes it and each run's report. With
--resume, runs of the same command and commit are taken from the folder, so that a long table can be made in parts.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motiongen_tools.bench.scenario import BUILT_IN, load_scenario
from motiongen_tools.bench.scenario import __file__ as scenario_file
from tests.bench.machine import ROOT, busy_share, commit, machine_facts
from tests.bench.revision import Revision, commit_tree
from tests.bench.scenario_rows import FOUND_HEADER, HEADER, found_row, rows_of

PRECISIONS = ("float32", "bfloat16")
SIZES = {("crowd", "bfloat16"): 200}
"""The number of characters, if not the scenario's own."""
_VOID = 3
_MARK = "run.json"


@dataclass(frozen=True)
class Case:
    """One line of the table: a scenario for each of the seeds."""

    scenario: str
    characters: int
    precision: str
    revision: Revision


def cases(options: argparse.Namespace, revisions: Sequence[Revision]) -> Iterator[Case]:
    """All cases, in the order of the table."""
    for index, name in enumerate(options.scenario):
        for precision in options.precision:
            own = SIZES.get((name, precision), load_scenario(name).characters)
            characters = max(1, round(options.load * (options.characters[index] if options.characters else own)))
            for revision in revisions:
                yield Case(name, characters, precision, revision)


def measure(case: Case, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Run one case and return its report. Raises CalledProcessError if it fails."""
    name = f"{case.scenario}-{case.characters}-{case.precision}-{case.revision.name}-{seed}".replace(" ", "-")
    out = options.out / name
    scenario = Path(scenario_file).parent / "scenarios" / f"{case.scenario}.yaml"
    command = [
        *case.revision.motiongen, "bench", "--start-server", "--scenario", str(scenario),
        "--characters", str(case.characters), "--seconds", str(options.seconds), "--seed", str(seed),
        "--out", str(out.resolve()), "--max-lag-ms", str(options.max_lag_ms),
        *(["--find", "--find-within", str(options.find_within), "--trial-seconds", "6"] if options.find else []),
        "--", "--precision", case.precision, *options.server,
    ]  # fmt: skip
    mark = {"command": command, "commit": commit()}
    # With uncommitted changes (a blank in the mark), an earlier run may have measured other files.
    if options.resume and " " not in mark["commit"] and (known := kept(out, mark)) is not None:
        return known
    (out / _MARK).unlink(missing_ok=True)
    others = busy_share()
    done = subprocess.run(
        command, cwd=case.revision.tree, env=case.revision.environment, stdout=subprocess.PIPE, text=True
    )
    if done.returncode not in (0, _VOID):
        print(done.stdout, file=sys.stderr)
        raise subprocess.CalledProcessError(done.returncode, command)
    (out / _MARK).write_text(json.dumps({**mark, "others": others()}, indent=1) + "\n", encoding="utf-8")
    found = kept(out, mark)
    assert found is not None
    return found


def kept(out: Path, mark: dict[str, Any]) -> dict[str, Any] | None:
    """The report in a run's folder; None if it is of another command or commit, or was cut short."""
    try:
        made = json.loads((out / _MARK).read_text(encoding="utf-8"))
        report = json.loads((out / "result.json").read_text(encoding="utf-8"))
    except OSError:
        return None
    if any(made[name] != value for name, value in mark.items()):
        return None
    return {**(report["result"] or {}), "search": report["search"], "others": made["others"]}


def baseline() -> str:
    """A sentence about what the machine does with one character after another, without the engine."""
    command = [sys.executable, "-m", "tests.bench.rollout_baseline", "--steps", "4", "--seconds", "5"]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    found = json.loads(done.stdout)
    return f"{found['windows_per_s']:.1f} windows/s of the plain rollout, float32, {found['threads']} threads"


def run(options: argparse.Namespace, revisions: Sequence[Revision], say: Callable[[str], None]) -> None:
    """Measure all cases, and pass each line of the table to `say` as soon as it is known."""
    for line in FOUND_HEADER if options.find else HEADER:
        say(line)
    for case in cases(options, revisions):
        label = case.precision if len(revisions) == 1 else f"{case.precision}, {case.revision.name}"
        if options.find:
            for seed in options.seeds:
                say(found_row(case.scenario, label, measure(case, seed, options)))
            continue
        reports = [measure(case, seed, options) for seed in options.seeds]
        for line in rows_of(case.scenario, case.characters, label, reports):
            say(line)


def main() -> int:
    options = parse()
    options.out.mkdir(parents=True, exist_ok=True)
    lines: list[str] = []

    def say(line: str) -> None:
        print(line, flush=True)
        lines.append(line)

    with ExitStack() as stack:
        revisions = [stack.enter_context(commit_tree(commit)) for commit in options.before]
        revisions.append(Revision("now", ROOT))
        run(options, revisions, say)
    say("")
    for name, value in {**machine_facts(), "baseline": baseline(), "command": " ".join(sys.argv[1:])}.items():
        say(f"- {name}: {value}")
    (options.out / "scenarios.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The options. Exits with code 2 if they make no sense."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.scenario_table", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("server", nargs="*", metavar="-- SETTING", help="for the servers, in addition to the precision")
    parser.add_argument("--scenario", nargs="+", default=list(BUILT_IN), choices=BUILT_IN)
    parser.add_argument("--characters", type=int, nargs="+", help="for each scenario (default: its own)")
    parser.add_argument("--precision", nargs="+", default=list(PRECISIONS), choices=PRECISIONS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="a run for each (default: 1)")
    parser.add_argument("--seconds", type=int, default=20, help="duration of each run (default: %(default)s)")
    parser.add_argument("--load", type=float, default=1.0, help="share of the characters (default: all)")
    parser.add_argument("--find", action="store_true", help="find the most characters served in full instead")
    parser.add_argument("--find-within", type=float, default=420.0, help="seconds a search (default: %(default)g)")
    parser.add_argument("--resume", action="store_true", help="reuse runs that are in the folder")
    parser.add_argument("--max-lag-ms", type=float, default=5.0, help="a later load is void (default: %(default)g)")
    parser.add_argument("--before", nargs="*", default=[], metavar="COMMIT", help="also measure these, in the same run")
    parser.add_argument("--out", type=Path, default=Path("out/scenarios"), help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    if options.characters and len(options.characters) != len(options.scenario):
        parser.error(f"--characters has {len(options.characters)} numbers; give one for each scenario")
    if not 0.0 < options.load <= 1.0:
        parser.error(f"--load is {options.load:g}; give a share above 0, up to 1")
    return options


if __name__ == "__main__":
    sys.exit(main())
