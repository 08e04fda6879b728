"""What the C++ and the Python client cost, compared: `python -m tests.bench.client_cost`.

The same crowd plays on one stream of the null server, alternately in C++ and in Python, in one run: everything that a
game does (receiving and keeping frames, reporting playheads, prompts), without poses and with poses at several rates.
Only the client process's CPU time counts, so the figures hold on a machine that is also used by others. The C++ is
built as the tests build it (-O1).
"""

from __future__ import annotations

import argparse
import asyncio
import json
import statistics
import subprocess
import sys
import time
from dataclasses import asdict, dataclass

from motiongen_client import MotionClient, SessionOptions
from motiongen_client.playback import Playback, Rows
from motiongen_client.session import Session
from tests.bench.machine import ROOT, busy_share, machine_facts
from tests.bench.null_process import NULL_SERVER, SETTINGS, server_process
from tests.cpp.building import build

EDIT_PERIOD_S = 5.0
TICKS_HZ = 20
"""The tick rate if no poses are computed."""
UNBOUNDED = ("--admit-load", "1000", "--degrade", "false")


@dataclass(frozen=True)
class Cost:
    """The cost of one trial. cpu_s: of the client process; held: frame times with no new frame to show."""

    cpu_s: float
    wall_s: float
    chunks: int
    edits: int
    held: int


async def play_in_python(address: str, characters: int, seconds: int, poses_hz: int) -> Cost:
    """Do the same as client/cpp/tests/client/client_cost.cpp, in this process."""
    chunks = count_chunks()
    async with MotionClient(address) as client, client.stream() as stream:
        crowd: list[Session] = []
        for first in range(0, characters, 50):
            seeds = range(first, min(first + 50, characters))
            opening = (stream.open("a person walks", options=SessionOptions(seed=n), keep_s=2.0) for n in seeds)
            crowd += await asyncio.gather(*opening)
        await asyncio.sleep(3)
        for each in crowd:
            each.poll()
        before, cpu_before_s = chunks[0], time.process_time()
        started_s = time.perf_counter()
        ticks_hz = poses_hz or TICKS_HZ
        edits = 0
        for tick in range(seconds * ticks_hz):
            if poses_hz or tick % TICKS_HZ == 0:  # without poses, poll once a second to keep the server going
                for each in crowd:
                    each.poll()
            while edits < (tick + 1) * characters / EDIT_PERIOD_S / ticks_hz:
                crowd[edits % characters].set_prompt("a person does number " + "x" * (1 + edits % 50))
                edits += 1
            await asyncio.sleep(max(started_s + (tick + 1) / ticks_hz - time.perf_counter(), 0))
        wall_s, cpu_s = time.perf_counter() - started_s, time.process_time() - cpu_before_s
        return Cost(cpu_s, wall_s, chunks[0] - before, edits, sum(each.stats.underruns for each in crowd))


def count_chunks() -> list[int]:
    """A counter of the chunks that playbacks take in."""
    count, add_chunk = [0], Playback.add_chunk

    def counting(self: Playback, plan: int, first_frame: int, rows: Rows, committed_to: int) -> None:
        count[0] += 1
        add_chunk(self, plan, first_frame, rows, committed_to)

    Playback.add_chunk = counting  # type: ignore[method-assign]
    return count


def trial(command: list[str]) -> Cost:
    """Run a client in its own process."""
    told = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return Cost(**{key: value for key, value in json.loads(told.stdout).items() if key != "messages"})


def row(client: str, poses_hz: int, characters: int, costs: list[Cost]) -> str:
    share = statistics.median(cost.cpu_s / cost.wall_s for cost in costs)
    chunk_us = statistics.median(1e6 * cost.cpu_s / cost.chunks for cost in costs)
    chunks = statistics.median(cost.chunks / cost.wall_s for cost in costs)
    held = sum(cost.held for cost in costs)
    return (
        f"| {client} | {poses_hz} | {100 * share:.1f} % | {1e6 * share / characters:.0f} us | {chunk_us:.1f} us "
        f"| {chunks:.0f} | {held} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.client_cost", description=__doc__)
    parser.add_argument("--characters", type=int, default=500, help="characters on one stream (default: %(default)s)")
    parser.add_argument("--seconds", type=int, default=10, help="duration of each trial (default: %(default)s)")
    parser.add_argument("--trials", type=int, default=3, help="trials of each client and rate (default: %(default)s)")
    parser.add_argument(
        "--poses-hz", type=int, nargs="*", default=[0, 20], help="poses a second (default: %(default)s)"
    )
    parser.add_argument("--python-at", metavar="ADDRESS", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.python_at:
        (poses_hz,) = options.poses_hz
        cost = asyncio.run(play_in_python(options.python_at, options.characters, options.seconds, poses_hz))
        print(json.dumps(asdict(cost)))
        return 0
    release = ("-DMOTIONGEN_TESTS=ON", "-DMOTIONGEN_EXAMPLES=ON")
    program = build("test", *release, targets=("client_cost",)) / "tests" / "client_cost"
    share, lines = busy_share(), []
    for poses_hz in options.poses_hz:
        sizes = (str(options.characters), str(options.seconds), str(poses_hz))
        in_python = [sys.executable, "-m", "tests.bench.client_cost", "--characters", sizes[0], "--seconds", sizes[1]]
        costs: dict[str, list[Cost]] = {"C++": [], "Python": []}
        for _ in range(options.trials):
            with server_process(NULL_SERVER, *SETTINGS, *UNBOUNDED) as server:
                costs["C++"].append(trial([str(program), server.address, *sizes]))
            with server_process(NULL_SERVER, *SETTINGS, *UNBOUNDED) as server:
                costs["Python"].append(trial([*in_python, "--python-at", server.address, "--poses-hz", sizes[2]]))
        lines += [row(client, poses_hz, options.characters, each) for client, each in costs.items()]
    print("| client | poses a second | of a core | a character and second | a chunk | chunks/s | frames held |")
    print("|---|---:|---:|---:|---:|---:|---:|", *lines, sep="\n")
    print("", *(f"- {name}: {value}" for name, value in machine_facts().items()), sep="\n")
    print(f"- others used: {share():.0%} of the machine meanwhile")
    return 0


if __name__ == "__main__":
    sys.exit(main())
