"""`make chaos`: random faults, drawn from a seed, one after another while characters play.

Two servers behind a proxy with a Redis, all real. For ten minutes the network is slow, stalls, falls silent or breaks,
processes are stopped for five seconds, disks are full, descriptors run out, clocks jump; the same seed gives the same
faults in the same order. Prints what the characters noticed of each kind. Exits with code 1 if an event was lost, a
committed frame changed, a character ended or did not come back, or a server ended by itself or with another exit code
than 0. Missed frames are reported, but allowed: a client whose connection is lost for longer than the look-ahead shows
the last frame.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.scale.characters import Cast
from tests.scale.impaired_line import ImpairedLine
from tests.scale.kills import Books
from tests.scale.proxies import CERTIFICATES, PROXIES, Missing, Proxy
from tests.scale.replicas import NULL_SERVER, SERVER, Replicas
from tests.scale.troubles import STOPPED_S, TROUBLES, World, false_clock

BETWEEN_S = 4.0
BACK_S = 60.0


@dataclass
class Noticed:
    """What characters noticed of one kind of fault, added up."""

    times: int = 0
    away_s: list[float] = field(default_factory=list)
    missed: int = 0
    resumed: int = 0
    anew: int = 0
    changed: int = 0
    unanswered: int = 0
    not_back: int = 0

    def row(self, name: str) -> str:
        most = max(self.away_s, default=0.0)
        lost = f"{len(self.away_s)} | {self.resumed} / {self.anew} | {most:.1f} s"
        counts = f"{self.missed} | {self.unanswered} | {self.changed} | {self.not_back}"
        return f"| {name} | {self.times} | {lost} | {counts} |"


def troubles(seed: int, kinds: list[str]) -> Iterator[tuple[str, float, random.Random]]:
    """An endless sequence of kinds, seconds and random generators; each kind occurs once before one is repeated."""
    draw = random.Random(seed)
    while True:
        for kind in draw.sample(kinds, len(kinds)):
            yield kind, draw.uniform(2.0, STOPPED_S), random.Random(draw.random())


async def play(world: World, options: argparse.Namespace) -> dict[str, Noticed]:
    """Cause one fault after another until the time is over."""
    found: dict[str, Noticed] = {}
    ends_at = time.monotonic() + 60 * options.minutes
    async with Cast(world.line.address, options.characters, CERTIFICATES / "authority.pem") as cast:
        await asyncio.sleep(BETWEEN_S)
        for kind, seconds, draw in troubles(options.seed, options.kinds):
            if time.monotonic() > ends_at or any(each.ended for each in cast.characters):
                break
            if not all(replica.is_running for replica in world.replicas.all):  # the report says how it ended
                break
            before, begun = Books.of(cast.characters), time.monotonic()
            async with TROUBLES[kind](world, draw) as hit:
                await asyncio.sleep(STOPPED_S if "stopped" in kind else seconds)
            await asyncio.sleep(BETWEEN_S)
            give_up_at = time.monotonic() + BACK_S
            # No event tells of it.
            while any(each.is_away for each in cast.characters) and time.monotonic() < give_up_at:  # noqa: ASYNC110
                await asyncio.sleep(0.1)
            after, noticed = Books.of(cast.characters), found.setdefault(kind, Noticed())
            away = [s for each in cast.characters for s in each.away_s(begun)]
            noticed.times += 1
            noticed.away_s += away
            noticed.not_back += sum(each.is_away for each in cast.characters)
            for name in ("missed", "resumed", "anew", "changed", "unanswered"):
                setattr(noticed, name, getattr(noticed, name) + getattr(after, name) - getattr(before, name))
            missed = after.missed - before.missed
            print(f"{kind} ({hit}, {seconds:.1f} s): {len(away)} lost connections, {missed} frames missed", flush=True)
        ended = [each.ended for each in cast.characters if each.ended]
    for why in sorted(set(ended)):
        print(f"DOES NOT HOLD: a character ended: {why}")
    found["all"] = Noticed(not_back=len(ended))
    for each in [*found.values()][:-1]:
        for name in vars(each):
            setattr(found["all"], name, getattr(found["all"], name) + getattr(each, name))
    return found


def report(found: dict[str, Noticed], exit_codes: dict[str, int | None]) -> int:
    """Print the result. Returns the exit code."""
    columns = ("times", "connections lost", "resumed / reopened", "longest without a server", "frames missed",
               "events lost", "committed frames changed", "not back")  # fmt: skip
    print(f"| trouble | {' | '.join(columns)} |\n|---|{'---:|' * len(columns)}")
    for name, noticed in found.items():
        print(noticed.row(name))
    together = found["all"]
    faults = [
        f"{name}: {getattr(together, name)}"
        for name in ("unanswered", "changed", "not_back")
        if getattr(together, name)
    ]
    faults += [f"{name} ended with {code}" for name, code in exit_codes.items() if code]
    print("\n".join(f"DOES NOT HOLD: {fault}" for fault in faults) or "all bounds hold")
    return 1 if faults else 0


async def run(options: argparse.Namespace, replicas: Replicas, proxy: Proxy, clock: Path) -> dict[str, Noticed]:
    async with ImpairedLine(f"127.0.0.1:{proxy.port}", random.Random(options.seed)) as line:
        return await play(World(replicas, proxy, line, clock), options)


def main() -> int:
    names = [each.name for each in PROXIES]
    parser = argparse.ArgumentParser(prog="make chaos", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--characters", type=int, default=12, help="default: %(default)s")
    parser.add_argument("--kinds", nargs="+", choices=list(TROUBLES), default=list(TROUBLES), help="default: all")
    parser.add_argument("--proxy", choices=names, default=names[0], help="default: %(default)s")
    parser.add_argument("--null", action="store_true", help="servers without a model")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="chaos-") as name:
        folder = Path(name)
        try:
            clock, environment = false_clock(folder)
            replicas = Replicas(folder, 2, program=NULL_SERVER if options.null else SERVER, environment=environment)
            with replicas, PROXIES[names.index(options.proxy)](folder, replicas.behind) as proxy:
                print(f"two servers behind {proxy.name}, seed {options.seed}", flush=True)
                found = asyncio.run(run(options, replicas, proxy, clock))
            for replica in replicas.all:
                if replicas.exit_codes[replica.name]:
                    print(f"{replica.name} ended with {replicas.exit_codes[replica.name]}:\n{replica.last_words()}")
        except Missing as missing:
            print(f"error: {missing}", file=sys.stderr)
            return 2
    return report(found, replicas.exit_codes)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that everything is cleaned up
    sys.exit(main())
