"""`make attack`: hostile clients of every kind against a real server, and a table of what its neighbours noticed.

    python -m tests.attack [--only KIND ...] [--seconds S] [--out FOLDER]

Ends with status 1 where neighbours noticed more than they may. Bounded: some twelve seconds an attack.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
from pathlib import Path

from tests.attack.attack import Attack, machine, run, table

ATTACKS = (
    Attack("nobody attacks", ""),
    Attack("empty events", "empty_events", 2),
    Attack("one event of 400,000 empty constraints", "empty_constraints", 2, grown_mib=300),
    Attack("450,000 empty events a message, nothing read", "huge_messages", 1),
    Attack("pings", "pings", 2),
    Attack("opens that must fail, with new prompts", "failing_opens", 2, built_in=True),
    Attack("16 new prompts an edit", "new_prompts", 2, built_in=True),
    Attack("playheads that lie", "liars", 2),
    Attack("playheads that lie, built-in model", "liars", 1, built_in=True),
    Attack("3,000 streams without hello", "silent_streams", 1),
    Attack("24 calls for the longest clips, nothing read", "unread_clips", 1),
    Attack("refused events on 40 streams, nothing read", "unread_streams", 1),
    Attack("catalogues", "catalogs", 2),
    Attack("600 connections where 400 descriptors are allowed", "connections", 1, most_files=400),
    Attack("garbage on the port", "garbage", 1),
    Attack("HERO sessions, as many as there may be, each edited ten times a second", "heroes", 1),
    Attack("playheads, 200 a message", "playheads", 2),
    Attack("3,000 streams with hello and no session", "empty_streams", 1),
    Attack("opens with names of 5,000 characters", "long_names", 2),
    Attack("idle connections on the port of operations", "idle_connections", 1, at_ops=True),
    Attack(
        "metrics that are asked for and not read, also at the end", "unread_metrics", 1, at_ops=True, to_the_end=True
    ),
)


async def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="kinds of tests.attack.hostile, or none")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each attack (default: %(default)s)")
    parser.add_argument("--out", type=Path, help="folder for attack.md")
    options = parser.parse_args()
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for number, attack in enumerate(ATTACKS):
            if options.only and attack.kind not in options.only:
                continue
            results.append(await run(attack, options.seconds, Path(folder) / f"{number}.log"))
            print(f"{attack.name}: {'; '.join(results[-1].faults) or 'held'}", flush=True)
    report = f"{table(results)}\n{machine()}, {options.seconds:g} s an attack\n"
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "attack.md").write_text(report, encoding="utf-8")
    print(report)
    return 1 if any(each.faults for each in results) else 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
