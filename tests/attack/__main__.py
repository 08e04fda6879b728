"""`make attack`: hostile clients of every kind against a real server, and a table of what its neighbours noticed.

    python -m tests.attack [--only KIND ...] [--seconds S] [--out FOLDER] [--pages PAGE ...]

A second table has how servers end, SIGTERM while they load among it (`tests.attack.endings`). Ends with status 1 where
neighbours noticed more than they may, or a server did not end as it must. Bounded: some twelve seconds an attack.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import shutil
import sys
import tempfile
from pathlib import Path

from tests.attack.attack import Attack, Result, machine, row, run, table
from tests.attack.endings import all_endings, endings_table

ENDINGS = "endings"
BEGIN, END = "<!-- made by: python -m tests.attack -->", "<!-- until here -->"

ATTACKS = (
    Attack("nobody attacks", ""),
    Attack("nobody attacks (built-in model)", "", built_in=True),
    Attack("empty events", "empty_events", 2),
    Attack("one event of 400,000 empty constraints", "empty_constraints", 2),
    Attack("one event that removes 300,000 constraints", "many_removals", 2),
    Attack("256 paths of nine minutes an edit", "long_paths", 2),
    Attack("256 rotations an edit, to be placed", "many_rotations", 2),
    Attack("opens with 255 rotations and one that is wrong", "refused_rotations", 2),
    Attack("450,000 empty events a message, nothing read", "huge_messages", 1),
    Attack(
        "450,000 empty events a message, from 1,000 streams at one moment",
        "first_messages",
        settings=("--peer-calls-per-second", "5000"),  # else it would take them ten seconds to begin
        grown_mib=600.0,  # all of them are on their way at once: 860 MiB, which were held for minutes
        takes_places=True,
    ),
    Attack("pings", "pings", 2),
    Attack("opens that must fail, with new prompts (built-in model)", "failing_opens", 2, built_in=True),
    Attack("16 new prompts an edit (built-in model)", "new_prompts", 2, built_in=True, elsewhere=True),
    Attack(
        "new prompts on 320 streams and in 32 clips of each of two addresses, at an encoder that takes 0.1 s",
        "prompts_over_streams",
        2,
        settings=("--peer-calls-per-second", "5000"),  # else it would take them three seconds to begin
        slow_encoder=True,
    ),
    Attack("playheads that lie", "liars", 2),
    Attack("playheads that lie (built-in model)", "liars", 1, built_in=True, elsewhere=True),
    Attack(
        "32 sessions that play at three times real time (built-in model)",
        "fast_players",
        1,
        built_in=True,
        elsewhere=True,
    ),
    Attack(
        "32 sessions that leap to their last frame once a second (built-in model)",
        "teleporters",
        1,
        built_in=True,
        elsewhere=True,
    ),
    Attack("a token that expires under load, and is shown on", "expired_tokens", 1, token_s=3.0),
    Attack("3,000 streams without hello", "silent_streams", 1),
    Attack("4,250 calls without their request", "half_open_calls", 1),
    Attack("4,250 calls and streams whose answers are not let through", "unread_calls", 1),
    Attack("calls of methods whose names are no text, with tokens that are none", "unreadable_names", 1),
    Attack(
        "calls of 90,000 headers of a byte each, 67 a second, by clients that do not heed the settings",
        "tiny_headers",
        1,
        edit_ms=500.0,  # a second where gRPC read them all the same; 0.1 to 0.2 at a load of six, on two cores
        grown_mib=4_000.0,  # gRPC's own, for seconds: not promised
    ),
    Attack("10,000 calls a second that are reset as soon as they are begun", "resets", 1),
    Attack("frames that HTTP/2 forbids, each on a connection of its own", "forbidden_frames", 1),
    Attack("20,000 frames a second that mean nothing", "needless_frames", 1),
    Attack("24 calls for the longest clips, nothing read", "unread_clips", 1),
    Attack("refused events on 40 streams, nothing read", "unread_streams", 1),
    Attack("catalogues", "catalogs", 2),
    Attack("600 connections where 400 descriptors are allowed", "connections", 1, most_files=400),
    Attack("garbage on the port", "garbage", 1),
    Attack("HERO sessions, as many as there may be, each edited ten times a second", "heroes", 1, takes_places=True),
    Attack("playheads, 200 a message", "playheads", 2),
    Attack("3,000 streams with hello and no session", "empty_streams", 1),
    Attack("opens with names of 5,000 characters", "long_names", 2),
    Attack("messages with some bytes changed, on streams and as requests of all methods", "mutations", 2),
    Attack("long edits behind prompts that wait", "edits_behind_prompts", 1),
    Attack("edits that are answered at length, and never confirmed", "unconfirmed_edits", 1, takes_places=True),
    Attack("4,000 watches of the health", "watches", 1),
    Attack("health, checked without end, 256 times at once", "health_checks", 1),
    Attack("reflection, asked for without end", "reflections", 1),
    Attack("readers of a byte a second", "byte_a_second", 1),
    Attack("streams that send what they may at once, and are begun anew", "burst_streams", 2),
    Attack(
        "512 sessions that play where there is room, and ask again (built-in model)",
        "crowds",
        1,
        built_in=True,
        after="welcome_crowds",
        takes_places=True,
    ),
    Attack(
        "all of these by chance, five at a time, seeds 1 and 2",
        "drawn",
        2,
        grown_mib=400.0,  # ten at once, each of which may have 200 by itself; what stays is `test_given_up_calls`'
        takes_places=True,
    ),
    Attack("idle connections on the port of operations", "idle_connections", 1, at_ops=True),
    Attack(
        "metrics that are asked for and not read, also at the end", "unread_metrics", 1, at_ops=True, to_the_end=True
    ),
)


class Rows:
    """Of the table, by attack: those of earlier runs too, where they were kept. out: the folder."""

    def __init__(self, out: Path | None) -> None:
        self._path = None if out is None else out / "rows.json"
        there = self._path is not None and self._path.exists()
        self._rows: dict[str, str] = json.loads(self._path.read_text("utf-8")) if there and self._path else {}

    def add(self, results: list[Result]) -> None:
        """Those of this run, instead of earlier ones."""
        self._rows |= {each.attack.name: row(each) for each in results}
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.write_text(json.dumps(self._rows, indent=1), encoding="utf-8")

    def in_order(self) -> list[str]:
        """As the attacks are listed."""
        return [self._rows[attack.name] for attack in ATTACKS if attack.name in self._rows]


def put_into(page: Path, made: str) -> None:
    """Replace what stands between the marks of a page by a table."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"{page} has no place for the table; put {BEGIN} and {END} there")
    page.write_text(f"{before}{BEGIN}\n\n{made}\n{END}{after}", encoding="utf-8")


async def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="kinds of tests.attack.hostile, nobody, endings")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each attack (default: %(default)s)")
    parser.add_argument("--out", type=Path, help="folder for attack.md and servers' logs; rows of earlier runs stay")
    parser.add_argument("--pages", type=Path, nargs="*", default=[], help="Markdown files to put the table into")
    options = parser.parse_args()
    results, endings, rows = [], [], Rows(options.out)
    with tempfile.TemporaryDirectory() as folder:
        for number, attack in enumerate(ATTACKS):
            if options.only and (attack.kind or "nobody") not in options.only:
                continue
            log = Path(folder) / f"{number}.log"
            results.append(await run(attack, options.seconds, log))
            rows.add(results[-1:])
            print(f"{attack.name}: {'; '.join(results[-1].faults) or 'held'}", flush=True)
            if options.out and results[-1].faults:
                shutil.copy(log, options.out / f"{attack.kind or 'nobody'}.log")
        if not options.only or ENDINGS in options.only:
            endings = await asyncio.to_thread(all_endings, Path(folder))
    report = f"{table(rows.in_order())}\n{machine()}, {options.seconds:g} s an attack\n"
    if endings:
        report += f"\n{endings_table(endings)}"
    if options.out:
        (options.out / "attack.md").write_text(report, encoding="utf-8")
    for page in options.pages:
        put_into(page, table(rows.in_order()))
    print(report)
    return 1 if any(each.faults for each in results) or not all(each.holds for each in endings) else 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
