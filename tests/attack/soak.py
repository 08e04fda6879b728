"""Sessions that come and go for minutes, over TLS and with a token: `python -m tests.attack.soak [--minutes M]`.

The load is that of `motiongen bench` (scenario churn), played in real time against a server that computes nothing.
Prints what the gateway and its engine hold in memory and in descriptors, by a line through the later half, and how many
frames were missed. Exit code 1 where descriptors grew, memory grew by more than a bound, or the load failed.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.attack.attack import machine
from tests.attack.server import attacked
from tests.conftest import ROOT
from tests.server.identity.files import AUTHORITY, TenantsFile, copy_pair

SAMPLE_S = 2.0
MOST_MIB_AN_HOUR = 60.0
"""A bound for minutes: what settles in the first ones looks like growth. Over hours it must come to less than 1."""
MIB = 1 << 20


async def soak(minutes: float, characters: int, folder: Path) -> int:
    tenants, token = TenantsFile(folder), folder / "token"
    token.write_text(tenants.one("quota = { calls_per_second = 1000 }"))
    certificate, key = copy_pair("server-1", folder)
    settings = ("--tls-certificate", certificate, "--tls-key", key, "--tenants", str(tenants.path))
    noted: list[tuple[float, float, float, float]] = []
    with attacked(folder / "log", settings) as server:
        load = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "motiongen_tools", "bench", "--server", server.address, "--scenario", "churn",
            "--characters", str(characters), "--seconds", str(round(60 * minutes)), "--seed", "1",
            "--tls-ca", AUTHORITY, "--token-file", str(token), "--out", str(folder / "out"), "--max-lag-ms", "60000",
            cwd=ROOT, stdout=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        begun_s, waiting = time.perf_counter(), asyncio.create_task(load.wait())
        engine = server.process.children()[0]
        while not waiting.done():
            await asyncio.wait({waiting}, timeout=SAMPLE_S)
            rss = [each.memory_info().rss / MIB for each in (server.process, engine)]
            noted.append(((time.perf_counter() - begun_s) / 3600, *rss, float(server.process.num_fds())))
        left_fds = server.process.num_fds()
    if waiting.result() or server.exit_code != 0:
        print(f"the load ended with {waiting.result()}, the server with {server.exit_code}")
        return 1
    later = np.array(noted[len(noted) // 2 :])
    slopes = [float(np.polyfit(later[:, 0], later[:, column], 1)[0]) for column in (1, 2)]
    counts = json.loads((folder / "out" / "result.json").read_text())["result"]["counts"]
    print(f"{minutes:g} minutes, {counts['sessions_opened']} sessions opened, "
          f"{sum(count for name, count in counts.items() if 'missed' in name)} frames missed")  # fmt: skip
    print(f"gateway {later[0, 1]:.1f} -> {later[-1, 1]:.1f} MiB ({slopes[0]:+.1f} MiB an hour), "
          f"engine {later[0, 2]:.1f} -> {later[-1, 2]:.1f} MiB ({slopes[1]:+.1f} MiB an hour), "
          f"descriptors {later[:, 3].max():.0f}, {left_fds} after it")  # fmt: skip
    print(machine())
    return 1 if max(slopes) > MOST_MIB_AN_HOUR or left_fds > later[:, 3].max() else 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.attack.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="default: %(default)s")
    parser.add_argument("--characters", type=int, default=40, help="at once (default: %(default)s)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(soak(options.minutes, options.characters, Path(folder)))


if __name__ == "__main__":
    sys.exit(main())
