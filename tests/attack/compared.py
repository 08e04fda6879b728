"""What hostile clients cost their neighbours in time, moment against moment: `python -m tests.attack.compared`.

    python -m tests.attack.compared [--only KIND ...] [--turns N] [--seconds S]

On one server, quiet moments and attacked ones take turns, so that what else the machine does falls on both alike. The
99th percentile of edits and pings is told for each. Kinds are those of `tests.attack.hostile`; by default such as do
not read. Where they take all places, it is also told how soon newcomers are refused.
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
"""Of neighbours, four sessions each: so many edits that one in a hundred can be told of."""


@dataclass
class Moments:
    """Of one sort, all together. refused_ms: of newcomers, how soon they were told."""

    edits_ms: list[float] = field(default_factory=list)
    pings_ms: list[float] = field(default_factory=list)
    refused_ms: list[float] = field(default_factory=list)
    missed: float = 0.0
    frames: int = 0

    def add(self, noticed: Noticed, refused_ms: list[float]) -> None:
        """One more."""
        self.edits_ms += noticed.edits_ms
        self.pings_ms += noticed.pings_ms
        self.refused_ms += refused_ms
        self.missed += noticed.missed * noticed.frames
        self.frames += noticed.frames

    @property
    def row(self) -> str:
        """Cells of a table."""
        refused = f"{p99(self.refused_ms):.0f} ms of {len(self.refused_ms)}" if self.refused_ms else ""
        return (
            f"{len(self.edits_ms)} | {p99(self.edits_ms):.0f} ms | {len(self.pings_ms)} | {p99(self.pings_ms):.0f} ms "
            f"| {self.missed / max(1, self.frames):.2%} | {refused}"
        )


def p99(values: list[float]) -> float:
    """The 99th percentile; infinite where there are none."""
    return float(np.percentile(values, 99)) if values else float("inf")


async def compare(attack: Attack, turns: int, seconds: float, log: Path) -> tuple[Moments, Moments]:
    """Quiet moments and attacked ones, in turn, on one server."""
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
    parser.add_argument("--only", nargs="*", default=list(SLOW_READERS), help="kinds (default: who does not read)")
    parser.add_argument("--turns", type=int, default=5, help="of both, for each kind (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each moment (default: %(default)s)")
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
