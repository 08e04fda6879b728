"""Use a server for hours, over TLS and with tokens: `python -m tests.attack.soak [--minutes M]`.

Characters of every kind play in real time and come and go (`soak.yaml`), on the built-in model with snapshots in an
SQLite file, or on engines that compute nothing (`--null`). `motiongen bench` makes the load, in parts of some minutes,
each over new connections; during the rest after each part nothing is open. Resident memory, descriptors, threads and
tasks are read all the time and written at once to `readings.jsonl` in the folder of `--out`; `--report` prints the
result of an unfinished run so far. Exits with code 1 if memory at the ends of the rests grows by more than 1 MiB an
hour (upper 95 % bound, after a warm-up of 20 minutes or a fifth of the time), if descriptors, threads or tasks at rest
have grown, if 1 % of the frames were missed, or if a part of the load failed.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

import psutil

from tests.attack.attack import machine
from tests.attack.server import BUILT_IN, NULL, Attacked, attacked
from tests.attack.soak_readings import WARM_S, Journal, Part, Reading, judge
from tests.conftest import ROOT
from tests.server.identity.files import AUTHORITY, TenantsFile, copy_pair

SAMPLE_S = 5.0
REST_S = 20.0
"""Within this time, everything that a part of the load has opened must be closed."""
SETTLED_S = 6.0
"""After that, time for gateway and engine to give memory back, which they do every two seconds."""
MIB = 1 << 20
SCENARIO = Path(__file__).with_name("soak.yaml")


class Server:
    """The server's processes and metrics."""

    def __init__(self, server: Attacked) -> None:
        self._server = server
        self._engine = server.process.children()[0]
        self._ready_s = time.monotonic()

    def read(self) -> Reading:
        """The server's state now."""
        gateway, engine = self._server.process, self._engine
        told = self._metrics()
        return Reading(
            at_s=round(time.monotonic() - self._ready_s, 1),
            rest=not told["motiongen_streams"] and not told["motiongen_sessions"],
            gateway_mib=round(gateway.memory_info().rss / MIB, 3),
            engine_mib=round(engine.memory_info().rss / MIB, 3),
            gateway_descriptors=gateway.num_fds(),
            engine_descriptors=engine.num_fds(),
            gateway_threads=gateway.num_threads(),
            engine_threads=engine.num_threads(),
            tasks=round(told["motiongen_event_loop_tasks"]),
        )

    def _metrics(self) -> dict[str, float]:
        """Metrics by name, summed over their labels."""
        sums = dict.fromkeys(("motiongen_streams", "motiongen_sessions", "motiongen_event_loop_tasks"), 0.0)
        with urllib.request.urlopen(f"http://127.0.0.1:{self._server.ops_port}/metrics", timeout=30) as answer:
            for name, value in re.findall(r"^(\w+)(?:\{.*\})? (\S+)$", answer.read().decode(), re.MULTILINE):
                if name in sums:
                    sums[name] += float(value)
        return sums


async def play_part(arguments: list[str], out: Path, sampled: Callable[[], None]) -> Part:
    """Run the load of one part. sampled: is called every few seconds meanwhile."""
    load = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "motiongen_tools", "bench", *arguments, "--out", str(out),
        cwd=ROOT, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    telling = asyncio.create_task(load.communicate())
    while not telling.done():
        await asyncio.wait({telling}, timeout=SAMPLE_S)
        sampled()
    _, errors = telling.result()
    if load.returncode:
        return Part(0, 0, 0, 0, 0, 0.0, f"exit code {load.returncode}: {errors.decode(errors='replace')[-300:]}")
    document = json.loads((out / "result.json").read_text())["result"]
    figures, counts = document["figures"]["all"], document["counts"]
    lost = {name: count for name, count in counts.items() if name.startswith(("sessions_lost", "streams_lost"))}
    return Part(
        counts["sessions_opened"], figures["edits"], figures["due"], figures["missed"], figures["refused"],
        document["generator"]["loop_lag_ms"].get("p99", 0.0), f"lost: {lost}" if lost else "",
    )  # fmt: skip


async def soak(options: argparse.Namespace, journal: Journal, folder: Path) -> int | None:
    """Run the soak. Returns the server's exit code."""
    tenants, token = TenantsFile(folder), folder / "token"
    token.write_text(tenants.one("quota = { calls_per_second = 1000 }"))
    certificate, key = copy_pair("server-1", folder)
    settings = ("--tls-certificate", certificate, "--tls-key", key, "--tenants", str(tenants.path),
                "--snapshot-store", f"sqlite:{folder}/snapshots.sqlite")  # fmt: skip
    with attacked(folder / "log", settings, module=NULL if options.null else BUILT_IN) as attacked_server:
        server, begun_s = Server(attacked_server), time.monotonic()
        number, left_s = 0, 60 * options.minutes
        while left_s > 0:
            number += 1
            seconds = max(10, round(min(left_s, 60 * options.part_minutes)))
            arguments = [
                "--server", attacked_server.address, "--scenario", str(SCENARIO), "--characters",
                str(options.characters), "--seconds", str(seconds), "--seed", str(options.seed + number),
                "--tls-ca", AUTHORITY, "--token-file", str(token), "--max-lag-ms", "600000",
            ]  # fmt: skip
            part = await play_part(arguments, folder / "out", lambda: journal.add(server.read()))
            journal.add(part)
            reading = await at_rest(server)
            journal.add(reading)
            rest = f"gateway {reading.gateway_mib:.1f} MiB, engine {reading.engine_mib:.1f} MiB"
            missed = f"{part.missed} of {part.due} frames missed"
            print(f"{reading.at_s / 60:.1f} minutes: {missed}, {rest} {part.failed}", flush=True)
            left_s = 60 * options.minutes - (time.monotonic() - begun_s)
    return attacked_server.exit_code


async def at_rest(server: Server) -> Reading:
    """A reading taken once nothing is open and memory has been given back, or after some time in any case."""
    reading = server.read()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(REST_S):
            while not reading.rest:  # there is no event for it across processes
                await asyncio.sleep(1)
                reading = server.read()
    await asyncio.sleep(SETTLED_S)
    return server.read()


def report(journal: Journal) -> int:
    """Print the result of a journal. Returns the exit code."""
    facts, readings, parts = journal.read()
    minutes = readings[-1].at_s / 60 if readings else 0.0
    warm_s = min(WARM_S, 60 * minutes / 5)
    told, faults = judge(readings, parts, warm_s)
    print(", ".join(f"{name}: {value}" for name, value in facts.items()))
    print(f"{minutes:.0f} minutes so far, {len(parts)} parts; slopes without the first {warm_s / 60:.0f} minutes")
    print("\n".join(told))
    print("\n".join(f"DOES NOT HOLD: {fault}" for fault in faults) or "all bounds hold")
    return 1 if faults else 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.attack.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=120.0, help="default: %(default)s")
    parser.add_argument("--part-minutes", type=float, default=5.0, help="of a part of the load (default: %(default)s)")
    parser.add_argument("--characters", type=int, default=12, help="how many at once (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the load (default: %(default)s)")
    parser.add_argument("--null", action="store_true", help="engines that compute nothing")
    parser.add_argument("--out", type=Path, default=Path("out/soak"), help="default: %(default)s")
    parser.add_argument("--report", action="store_true", help="only print the result so far of the run in --out")
    options = parser.parse_args()
    journal = Journal(options.out / "readings.jsonl")
    if options.report:
        return report(journal)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=ROOT).stdout
    journal.begin({
        "commit": commit.strip(), "begun": time.strftime("%Y-%m-%d %H:%M"), "minutes": options.minutes,
        "characters": options.characters, "model": "none" if options.null else "motiongen-mini",
        "cores": psutil.cpu_count(), "seed": options.seed,
    })  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        exit_code = asyncio.run(soak(options, journal, Path(folder)))
    faulty = report(journal)
    print(f"the server exited with {exit_code}; {machine()}")
    return 1 if faulty or exit_code else 0


if __name__ == "__main__":
    sys.exit(main())
