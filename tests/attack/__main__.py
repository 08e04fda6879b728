"""`make attack`: hostile clients of every kind against a real server, and a table of what good clients noticed.

    python -m tests.attack [--only KIND ...] [--seconds S] [--out FOLDER] [--pages PAGE ...]

A second table shows how servers end after SIGTERM, also while they load (`tests.attack.endings`). Exits with code 1 if
a bound of an attack was exceeded, or a server did not end properly. Takes about twelve seconds for each attack.
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
    Attack("no attack", ""),
    Attack("no attack (built-in model)", "", built_in=True),
    Attack("empty events", "empty_events", 2),
    Attack("one event with 400,000 empty constraints", "empty_constraints", 2),
    Attack("one event that removes 300,000 constraints", "many_removals", 2),
    Attack("edits with 256 nine-minute paths each", "long_paths", 2),
    Attack("edits with 256 rotations each, for the server to place", "many_rotations", 2),
    Attack("opens with 255 valid rotations and an invalid one", "refused_rotations", 2),
    Attack("messages of 450,000 empty events, answers not read", "huge_messages", 1),
    Attack(
        "messages of 450,000 empty events, from 1,000 streams at once",
        "first_messages",
        settings=("--peer-calls-per-second", "5000"),  # otherwise they would take ten seconds to begin
        grown_mib=600.0,  # 860 MiB are on their way at once; they were once held for minutes
        takes_places=True,
    ),
    Attack("pings", "pings", 2),
    Attack("opens of an unknown rig, with new prompts (built-in model)", "failing_opens", 2, built_in=True),
    Attack("edits with 16 new prompts each (built-in model)", "new_prompts", 2, built_in=True, elsewhere=True),
    Attack(
        "new prompts on 320 streams and in 32 clips from each of two addresses; the text encoder takes 0.1 s",
        "prompts_over_streams",
        2,
        settings=("--peer-calls-per-second", "5000"),  # otherwise they would take three seconds to begin
        slow_encoder=True,
    ),
    Attack("false playheads", "liars", 2),
    Attack("false playheads (built-in model)", "liars", 1, built_in=True, elsewhere=True),
    Attack(
        "32 sessions that play at three times real time (built-in model)",
        "fast_players",
        1,
        built_in=True,
        elsewhere=True,
    ),
    Attack(
        "32 sessions that jump to their last frame once a second (built-in model)",
        "teleporters",
        1,
        built_in=True,
        elsewhere=True,
    ),
    Attack("a token that expires under load and is still used", "expired_tokens", 1, token_s=3.0),
    Attack("3,000 streams without a hello", "silent_streams", 1),
    Attack("4,250 calls that never send their request", "half_open_calls", 1),
    Attack("4,250 calls and streams that block their answers by flow control", "unread_calls", 1),
    Attack("calls of methods whose names are not text, with invalid tokens", "unreadable_names", 1),
    Attack(
        "67 calls a second with 90,000 one-byte headers each, from clients that ignore the header limit",
        "tiny_headers",
        1,
        edit_ms=500.0,  # 1,000 before gRPC's reading was limited; 100 to 200 at a load of six, on two cores
        grown_mib=4_000.0,  # held by gRPC itself for seconds; see "What is not promised" in docs/security.md
    ),
    Attack("10,000 calls a second that are reset as soon as they begin", "resets", 1),
    Attack("frames that HTTP/2 forbids, each on its own connection", "forbidden_frames", 1),
    Attack("20,000 HTTP/2 frames a second without effect", "needless_frames", 1),
    Attack("24 calls for the longest clips, answers not read", "unread_clips", 1),
    Attack("refused events on 40 streams, answers not read", "unread_streams", 1),
    Attack("sessions that are resumed again and again on their own stream, frames not read", "unread_resumes", 1),
    Attack("sessions that are closed and opened again and again, frames not read", "unread_reopenings", 1),
    Attack("catalogue requests", "catalogs", 2),
    Attack("600 connections with a limit of 400 descriptors", "connections", 1, most_files=400),
    Attack("garbage on the gRPC port", "garbage", 1),
    Attack("as many HERO sessions as are admitted, each edited ten times a second", "heroes", 1, takes_places=True),
    Attack("messages of 200 playheads", "playheads", 2),
    Attack("3,000 streams with a hello and no session", "empty_streams", 1),
    Attack("opens with model and rig names of 5,000 characters", "long_names", 2),
    Attack("valid messages with some bytes changed, to all methods", "mutations", 2),
    Attack("long edits queued behind waiting prompts", "edits_behind_prompts", 1),
    Attack("edits with long answers that are never confirmed", "unconfirmed_edits", 1, takes_places=True),
    Attack("4,000 health watches", "watches", 1),
    Attack("health checks in a loop, 256 at a time", "health_checks", 1),
    Attack("reflection requests in a loop", "reflections", 1),
    Attack("clients that read one byte a second", "byte_a_second", 1),
    Attack("streams that send a second's worth of events at once, then start again", "burst_streams", 2),
    Attack(
        "512 sessions that retry until they are admitted (built-in model)",
        "crowds",
        1,
        built_in=True,
        after="welcome_crowds",
        takes_places=True,
    ),
    Attack(
        "random attacks of these kinds, five at a time, seeds 1 and 2",
        "drawn",
        2,
        grown_mib=400.0,  # ten at once, each may take 200 by itself; for what is left see `test_given_up_calls`
        takes_places=True,
    ),
    Attack("incomplete requests on the operations port", "idle_connections", 1, at_ops=True),
    Attack("metrics requested and not read, also during shutdown", "unread_metrics", 1, at_ops=True, to_the_end=True),
)


class Rows:
    """The rows of the table by attack, also those that earlier runs left in the folder `out`."""

    def __init__(self, out: Path | None) -> None:
        self._path = None if out is None else out / "rows.json"
        there = self._path is not None and self._path.exists()
        self._rows: dict[str, str] = json.loads(self._path.read_text("utf-8")) if there and self._path else {}

    def add(self, results: list[Result]) -> None:
        """Add rows of this run, which replace earlier ones of the same attacks."""
        self._rows |= {each.attack.name: row(each) for each in results}
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.write_text(json.dumps(self._rows, indent=1), encoding="utf-8")

    def in_order(self) -> list[str]:
        """The rows in the order in which the attacks are listed."""
        return [self._rows[attack.name] for attack in ATTACKS if attack.name in self._rows]


def put_into(page: Path, made: str) -> None:
    """Replace what is between the marks of a page by a table. Raises ValueError if the marks are missing."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"{page} has no place for the table; put {BEGIN} and {END} into it")
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
