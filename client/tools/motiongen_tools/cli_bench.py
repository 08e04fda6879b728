"""`motiongen bench`: put a load on a server, and report the results as tables, JSON, a picture and a page."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import importlib.util
import math
import os
import secrets
import sys
from dataclasses import replace
from pathlib import Path

from motiongen_client.errors import InvalidInput, MissingExtra
from motiongen_tools.arguments import add_start_timeout, check_folder_to_write, number_above_zero, whole_number
from motiongen_tools.bench import terminal
from motiongen_tools.bench.load import Load
from motiongen_tools.bench.report import write_report
from motiongen_tools.bench.result import Result, Standard
from motiongen_tools.bench.run import run_load
from motiongen_tools.bench.scenario import BUILT_IN, load_scenario
from motiongen_tools.bench.search import Found, find_most
from motiongen_tools.connection import connection_of
from motiongen_tools.console import make_console, starting
from motiongen_tools.server_process import ServerProcess

VOID = 3  # exit code of a run whose figures do not count
_CHARACTERS_A_PROCESS = 2000
REST_S = 10.0
DEFAULT_TRIAL_SECONDS = 10
MOST_CHARACTERS, MOST_SECONDS, MOST_PROCESSES = 1_000_000, 1_000_000, 1024
"""A whole load is drawn in advance and held in memory, so larger values can only be mistakes."""
_NEEDED = {"hdrh": "hdrhistogram", "matplotlib": "matplotlib", "psutil": "psutil", "yaml": "pyyaml"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command, except those that choose the server."""
    parser.add_argument(
        "server_arguments", nargs="*", metavar="-- SETTING", help="settings of the server that --start-server starts"
    )
    scenarios = f"{', '.join(BUILT_IN)}, or a YAML or JSON file"
    parser.add_argument("--scenario", default="crowd", metavar="NAME", help=f"{scenarios} (default: %(default)s)")
    parser.add_argument(
        "--characters",
        type=whole_number(1, MOST_CHARACTERS),
        metavar="N",
        help="how many at once (default: the scenario's)",
    )
    parser.add_argument(
        "--seconds",
        type=whole_number(1, MOST_SECONDS),
        default=30,
        metavar="N",
        help="seconds to measure, after warming up (default: %(default)s)",
    )
    parser.add_argument("--seed", type=whole_number(0), metavar="N", help="same seed, same load (default: a new one)")
    parser.add_argument("--steps", type=whole_number(1), metavar="N", help="denoising steps (default: the server's)")
    parser.add_argument(
        "--processes",
        type=whole_number(1, MOST_PROCESSES),
        metavar="N",
        help="processes that make the load (default: by characters and cores)",
    )
    parser.add_argument(
        "--program",
        type=Path,
        metavar="PATH",
        help="a motiongen-load (client/cpp) that makes the load, for thousands of characters per core",
    )
    parser.add_argument("--find", action="store_true", help="find the most characters that are served in full")
    parser.add_argument(
        "--max-misses",
        type=number_above_zero,
        default=100 * Standard.max_miss_ratio,
        metavar="PERCENT",
        help="share of late frames below which characters count as served in full (default: %(default)g)",
    )
    parser.add_argument(
        "--trial-seconds",
        type=whole_number(1, MOST_SECONDS),
        metavar="N",
        help="seconds to measure in each trial of --find; its answer is confirmed with --seconds "
        f"(default: {DEFAULT_TRIAL_SECONDS})",
    )
    parser.add_argument(
        "--find-within",
        type=number_above_zero,
        metavar="SECONDS",
        help="time after which --find answers with what it knows (default: when it is sure)",
    )
    parser.add_argument(
        "--max-lag-ms",
        type=number_above_zero,
        default=Standard.max_lag_ms,
        metavar="MS",
        help="a run is void when the load itself was later than this (p99; default: %(default)g)",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/load"), metavar="FOLDER", help="of the report (default: %(default)s)"
    )
    add_start_timeout(parser)


async def bench(options: argparse.Namespace) -> int:
    """Run the load, print and write the results. Returns 3 if the figures do not count, otherwise 0."""
    console = make_console()
    _check_report(options.out)
    _check_program(options.program)
    standard = Standard(options.max_misses / 100, options.max_lag_ms)
    scenario = load_scenario(options.scenario)
    load = Load(
        address=options.server,
        scenario=scenario,
        characters=options.characters or scenario.characters,
        seconds=options.seconds,
        seed=secrets.randbits(32) if options.seed is None else options.seed,
        denoise_steps=options.steps,
        connection=connection_of(options),
        program=options.program and options.program.absolute(),  # a bare name would be searched in PATH
    )
    with contextlib.ExitStack() as stack:
        pid, ops_address = None, ""
        if options.start_server:
            with starting(console, "starting a server") as tell:
                own = ServerProcess(options.server_arguments, ready_timeout_s=options.start_timeout, tell=tell)
                server = stack.enter_context(own)
            load, pid, ops_address = replace(load, address=server.address), server.pid, server.ops_address
        console.print(terminal.describe(load), soft_wrap=True)

        async def run(load: Load) -> Result:
            alone = 1 if load.program is not None else num_processes(load.characters)
            load = replace(load, processes=options.processes or alone)
            with terminal.showing(console, load) as tell:
                return await run_load(load, tell, standard, pid, ops_address)

        found: Found | None = None
        result: Result | None
        if options.find:
            found = await find_most(
                load,
                run,
                options.trial_seconds or DEFAULT_TRIAL_SECONDS,
                lambda trial: console.print(terminal.describe_trial(trial), soft_wrap=True),
                lambda: asyncio.sleep(REST_S),
                within_s=options.find_within or math.inf,
            )
            result = found.result
        else:
            result = await run(load)
        # before the server is stopped, which fails if it has died: that must not cost what was measured
        if result is not None:
            terminal.print_result(console, result)
        if found is not None:
            console.print(terminal.describe_found(found), soft_wrap=True)
        for path in write_report(options.out, standard, result, found):
            console.print(f"wrote {path}", soft_wrap=True)
    if found is not None and found.failure:
        print(f"error: {found.failure}", file=sys.stderr)
        return 1
    if found is not None:
        return VOID if found.limited_by_generator else 0
    return VOID if result is None or result.void_reasons() else 0


def _check_report(out: Path) -> None:
    """Check before the run that its report can be written. Raises MissingExtra, InvalidInput."""
    for module, package in _NEEDED.items():
        if importlib.util.find_spec(module) is None:
            raise MissingExtra("motiongen bench", package, "bench")
    check_folder_to_write("--out", out)


def _check_program(program: Path | None) -> None:
    """Raises InvalidInput if the program cannot be run."""
    if program is not None and not (program.is_file() and os.access(program, os.X_OK)):
        raise InvalidInput(
            "--program", str(program), "a motiongen-load, which `make cpp` builds in out/cpp/release/load"
        )


def num_processes(characters: int) -> int:
    """Enough processes for that many characters, but at most half the cores: the server may need the rest."""
    return max(1, min((os.cpu_count() or 1) // 2, math.ceil(characters / _CHARACTERS_A_PROCESS)))


def check(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """If options do not fit together, print why and exit with 2."""
    if options.server_arguments and not options.start_server:
        parser.error(f"{options.server_arguments[0]!r} is for a server that this starts: give --start-server too")
    for name in () if options.find else ("trial_seconds", "find_within"):
        if getattr(options, name) is not None:
            parser.error(f"--{name.replace('_', '-')} is for a search: give --find too")
