"""Replace servers one by one, and reload the proxy, while characters play: `python -m tests.scale.rolling`.

Each server in turn is asked to drain (SIGTERM), ends, and is started again; the next one follows when it is ready. Then
the proxy reloads its configuration, once for each server. Prints what the characters noticed in each step; exits with
code 1 if a frame was missing, a committed frame changed, an edit was lost or a session was reopened.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
import tempfile
import time
from pathlib import Path

from tests.scale.characters import Cast, percentile
from tests.scale.kills import Books
from tests.scale.proxies import CERTIFICATES, PROXIES, Missing, Proxy
from tests.scale.replicas import NULL_SERVER, SERVER, Replica, Replicas
from tests.waiting import until

BEFORE_S, AFTER_S = 4.0, 3.0


async def replace(replica: Replica) -> None:
    """Drain a server, and start it again."""
    assert replica.process is not None
    replica.send(signal.SIGTERM)
    exit_code = await asyncio.to_thread(replica.process.wait, 60)
    if exit_code:
        raise RuntimeError(f"{replica.name} ended with exit code {exit_code} when it was asked to drain")
    replica.begin()
    await asyncio.to_thread(until, lambda: replica.is_ready)


async def play(replicas: Replicas, proxy: Proxy, num_characters: int) -> bool:
    """Returns whether no character noticed anything."""
    async with Cast(proxy.address, num_characters, CERTIFICATES / "authority.pem") as cast:
        await asyncio.sleep(BEFORE_S)
        begun, first = time.monotonic(), Books.of(cast.characters)
        steps = [(f"{each.name} is replaced", replace(each)) for each in replicas.all]
        steps += [(f"{proxy.name} is reloaded", asyncio.to_thread(proxy.reload)) for _ in replicas.all]
        print("| step | connections lost | resumed / reopened | longest away | frames missed | changed | edits lost |")
        print("|---|---:|---:|---:|---:|---:|---:|")
        for name, step in steps:
            before, at = Books.of(cast.characters), time.monotonic()
            await step
            await asyncio.sleep(AFTER_S)
            after = Books.of(cast.characters)
            away = [s for each in cast.characters for s in each.away_s(at)]
            resumed, anew = after.resumed - before.resumed, after.anew - before.anew
            missed, changed = after.missed - before.missed, after.changed - before.changed
            unanswered, most = after.unanswered - before.unanswered, max(away, default=0.0)
            counts = f"{missed} | {changed} | {unanswered}"
            print(f"| {name} | {len(away)} | {resumed} / {anew} | {most:.2f} s | {counts} |", flush=True)
        last = Books.of(cast.characters)
        away = [s for each in cast.characters for s in each.away_s(begun)]
        ended = [each.ended for each in cast.characters if each.ended]
        not_back = sum(each.is_away for each in cast.characters)
        shown = sum(each.shown for each in cast.characters)
        print(f"without a server, p50 / p99: {percentile(away, 0.5):.2f} / {percentile(away, 0.99):.2f} s; "
              f"frames shown: {shown}; ended: {len(ended)} {ended[:1] or ''}")  # fmt: skip
        noticed = last.missed - first.missed, last.changed, last.unanswered, last.anew, len(ended), not_back
        print("no character noticed anything" if not any(noticed) else "DOES NOT HOLD: characters noticed something")
        return not any(noticed)


def main() -> int:
    names = [each.name for each in PROXIES]
    parser = argparse.ArgumentParser(prog="python -m tests.scale.rolling", description=__doc__)
    parser.add_argument("--servers", type=int, default=3, help="default: %(default)s")
    parser.add_argument("--characters", type=int, default=12, help="default: %(default)s")
    parser.add_argument("--proxy", choices=names, default=names[0], help="default: %(default)s")
    parser.add_argument("--null", action="store_true", help="servers without a model")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="rolling-") as name:
        folder = Path(name)
        try:
            with (
                Replicas(folder, options.servers, program=NULL_SERVER if options.null else SERVER) as replicas,
                PROXIES[names.index(options.proxy)](folder, replicas.behind) as proxy,
            ):
                return 0 if asyncio.run(play(replicas, proxy, options.characters)) else 1
        except Missing as missing:
            print(f"error: {missing}", file=sys.stderr)
            return 2


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that everything is cleaned up
    sys.exit(main())
