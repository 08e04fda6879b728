"""Whether SIGTERM ends a server with exit code 0 in any situation: `python -m tests.attack.endings [--times N]`.

`python -m tests.attack` prints the same table after its own.

The table has a row for each situation, with a new server: while it loads the built-in model, at times spread over the
start; with a second SIGTERM; and with clients that do not read. Exits with code 1 if a server ended with another exit
code, or later than its grace and a margin.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.attack.attack import Attack, hostile, machine
from tests.attack.server import BUILT_IN, NULL, ORDINARY, attacked
from tests.conftest import ROOT

TIMES = 9
LIMIT_S = 60.0
BEYOND_GRACE_S = 5.0
"""The margin that an orchestrator adds to the grace; see docs/operations.md."""
LONG_GRACE = ("--drain-grace-s", "3600")
HOSTILE_S = 2.5


def catches_sigterm(pid: int) -> bool:
    """Whether a process has a handler for SIGTERM; it has none before Python runs."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) & 1 << (signal.SIGTERM - 1))


@dataclass(frozen=True)
class Ending:
    """exit_code: None if the server did not end in time. took_s: from the last SIGTERM."""

    moment: str
    exit_code: int | None
    took_s: float

    @property
    def holds(self) -> bool:
        return self.exit_code == 0 and self.took_s <= BEYOND_GRACE_S + 0.5


@contextmanager
def loading(log: Path) -> Iterator[subprocess.Popen[str]]:
    """A server that starts with the built-in model, and handles SIGTERM from now on."""
    with log.open("w", encoding="utf-8") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", *BUILT_IN, *ORDINARY], cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True
        )
    try:
        while not catches_sigterm(process.pid):
            time.sleep(0.001)
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def seconds_to_load(log: Path) -> float:
    """The time from when SIGTERM is handled until the server is ready."""
    with loading(log) as process:
        begun_s = time.perf_counter()
        assert process.stdout is not None
        process.stdout.readline()
        return time.perf_counter() - begun_s


def end(process: subprocess.Popen[str], moment: str, signals: int = 1) -> Ending:
    """Send so many SIGTERMs."""
    for _ in range(signals):
        process.send_signal(signal.SIGTERM)
    begun_s = time.perf_counter()
    try:
        return Ending(moment, process.wait(LIMIT_S), time.perf_counter() - begun_s)
    except subprocess.TimeoutExpired:
        return Ending(moment, None, LIMIT_S)


def while_it_loads(log: Path, times: int) -> list[Ending]:
    """Send SIGTERM at times spread evenly over the start, once and twice."""
    whole_s = seconds_to_load(log)
    endings = []
    for number in range(times):
        with loading(log) as process:
            time.sleep(whole_s * number / times)
            signals = 1 + number % 2
            moment = f"{number / times:.0%} of the start, " + ("once", "twice")[signals - 1]
            endings.append(end(process, moment, signals))
    return endings


def while_it_serves(log: Path, moment: str, kind: str, settings: tuple[str, ...], signals: int, at_ops: bool) -> Ending:
    """Send SIGTERM while hostile clients of a kind are connected."""
    with ExitStack() as still_there, attacked(log, settings, module=NULL) as server:
        still_there.enter_context(hostile(Attack(moment, kind, at_ops=at_ops), server))
        time.sleep(HOSTILE_S)
        for _ in range(signals - 1):
            os.kill(server.process.pid, signal.SIGTERM)
            time.sleep(0.2)
        begun_s = time.perf_counter()
    return Ending(moment, server.exit_code, time.perf_counter() - begun_s)


SERVING = (
    ("streams that are not read", "unread_streams", (), 1, False),
    ("clients that read a byte per second", "byte_a_second", (), 1, False),
    ("clips that are not read", "unread_clips", (), 1, False),
    ("metrics that are not read", "unread_metrics", (), 1, True),
    ("twice, with a grace of an hour, streams that are not read", "unread_streams", LONG_GRACE, 2, False),
    ("twice, with a grace of an hour, metrics that are not read", "unread_metrics", LONG_GRACE, 2, True),
)


def all_endings(folder: Path, times: int = TIMES) -> list[Ending]:
    """The endings in all situations. times: how many while the server loads."""
    log = folder / "endings.log"
    endings = while_it_loads(log, times)
    for moment, kind, settings, signals, at_ops in SERVING:
        endings.append(while_it_serves(log, moment, kind, settings, signals, at_ops))
    return endings


def endings_table(endings: list[Ending]) -> str:
    """A Markdown table with a row for each ending."""
    rows = [
        f"| {each.moment} | {each.exit_code} | {each.took_s:.1f} s | {'held' if each.holds else 'FAILED'} |"
        for each in endings
    ]
    return "\n".join(["| SIGTERM | exit code | took | verdict |", "|---|---:|---:|---|", *rows]) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.attack.endings", description=__doc__)
    parser.add_argument("--times", type=int, default=TIMES, help="endings while it loads (default: %(default)s)")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        endings = all_endings(Path(folder), asked.times)
    print(f"{endings_table(endings)}\n{machine()}")
    return 0 if all(each.holds for each in endings) else 1


if __name__ == "__main__":
    sys.exit(main())
