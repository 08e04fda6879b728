"""By how much hostile clients raise other clients' latency: `python -m tests.attack.compared`.

    python -m tests.attack.compared [--only KIND ...] [--turns N] [--seconds S]

Quiet periods and attacks alternate on one server, so that other work on the machine affects both alike. The table has
the 99th percentiles of edits and pings for both. Kinds are those of `tests.attack.hostile`; the default is those that
do not read. For kinds that take all places, it also has how soon newcomers are refused.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.attack.__main__ import ATTACKS
from tests.attack.attack import WARM_S, Attack, hostile, machine
from tests.attack.neighbours import Noticed, neighbours
from tests.attack.newcomers import newcomers
from tests.attack.server import attacked

SLOW_READERS = ("byte_a_second", "unread_streams", "unread_clips")
STREAMS = 9
"""Streams of good clients, four sessions each: they make enough edits for a 99th percentile."""


@dataclass
class Moments:
    """The figures of all quiet periods, or of all attacks. refused_ms: how soon newcomers were refused."""

    edits_ms: list[float] = field(default_factory=list)
    pings_ms: list[float] = field(default_factory=list)
    refused_ms: list[float] = field(default_factory=list)
    missed: float = 0.0
    frames: int = 0

    def add(self, noticed: Noticed, refused_ms: list[float]) -> None:
        """Add a period."""
        self.edits_ms += noticed.edits_ms
        self.pings_ms += noticed.pings_ms
        self.refused_ms += refused_ms
        self.missed += noticed.missed * noticed.frames
        self.frames += noticed.frames

    @property
    def row(self) -> str:
        """Cells of the table."""
        refused = f"{p99(self.refused_ms):.0f} ms of {len(self.refused_ms)}" if self.refused_ms else ""
        return (
            f"{len(self.edits_ms)} | {p99(self.edits_ms):.0f} ms | {len(self.pings_ms)} | {p99(self.pings_ms):.0f} ms "
            f"| {self.missed / max(1, self.frames):.2%} | {refused}"
        )


def p99(values: list[float]) -> float:
    """The 99th percentile; infinite if there are no values."""
    return float(np.percentile(values, 99)) if values else float("inf")


async def compare(attack: Attack, turns: int, seconds: float, log: Path) -> tuple[Moments, Moments]:
    """Measure quiet periods and attacks, alternately, on one server."""
    quiet, troubled = Moments(), Moments()
    with attacked(log, attack.server_settings, attack.most_files, attack.module) as server:
        async with neighbours(server.address, STREAMS) as good, newcomers(server.address) as coming:
            for _ in range(turns):
                await asyncio.sleep(2 * WARM_S)
                good.forget()
                coming.forget()
                await asyncio.sleep(seconds)
                quiet.add(good.noticed(), coming.refused_ms)
                with hostile(attack, server) as clients:
                    await clients.begun()
                    await asyncio.sleep(WARM_S)
                    good.forget()
                    coming.forget()
                    await asyncio.sleep(seconds)
                    troubled.add(good.noticed(), coming.refused_ms)
    return quiet, troubled


async def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.attack.compared", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--only", nargs="*", default=list(SLOW_READERS), help="kinds (default: those that do not read)")
    parser.add_argument("--turns", type=int, default=5, help="periods of both, for each kind (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=6.0, help="length of a period (default: %(default)s)")
    options = parser.parse_args()
    print("| attack | moments | edits | edits p99 | pings | pings p99 | frames missed | newcomers refused, p99 |")
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    for attack in ATTACKS:
        if attack.kind and attack.kind in options.only:
            with tempfile.TemporaryDirectory() as folder:
                quiet, troubled = await compare(attack, options.turns, options.seconds, Path(folder) / "log")
            print(f"| {attack.name} | quiet | {quiet.row} |\n| | attacked | {troubled.row} |", flush=True)
    print(f"\n{machine()}, {options.turns} turns of {options.seconds:g} s each")
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
