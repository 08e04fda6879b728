"""`make scale-demo`: kill one of two servers while 40 characters play, and print what they notice.

Uses the machine's Redis and proxy (apt-get install redis-server haproxy); nothing of them remains after the demo.
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
from tests.scale.proxies import CERTIFICATES, PROXIES, Missing
from tests.scale.replicas import NULL_SERVER, SERVER, Replicas

BEFORE_S = 8.0


async def play(address: str, replicas: Replicas, options: argparse.Namespace) -> bool:
    """Returns whether no character noticed anything that it must not notice."""
    async with Cast(address, options.characters, CERTIFICATES / "authority.pem") as cast:
        print(f"{len(cast.characters)} characters are open", flush=True)
        await asyncio.sleep(BEFORE_S)
        before = [each.underruns for each in cast.characters]
        shares = {each.name: int(each.metric("motiongen_sessions")) for each in replicas.all}
        saved = sum(each.metric("motiongen_snapshots_total") for each in replicas.all)
        victim = max(replicas.all, key=lambda each: shares[each.name])
        print(f"sessions: {shares}; {saved:.0f} snapshots were written; frames not in time so far: {sum(before)}")
        killed_at = time.monotonic()
        victim.send(signal.SIGKILL if options.how == "kill" else signal.SIGTERM)
        did = "killed" if options.how == "kill" else "asked to drain"
        print(f"{victim.name}, with {shares[victim.name]} sessions, is {did}", flush=True)
        await asyncio.sleep(options.seconds)
        hit = [each for each in cast.characters if any(at >= killed_at for at in each.lost_at)]
        away = [s for each in hit for s in each.away_s(killed_at)]
        missed = [each.underruns - count for each, count in zip(cast.characters, before, strict=True)]
        of_hit = [count for each, count in zip(cast.characters, missed, strict=True) if each in hit]
        resumed, anew = (
            sum(each.session.stats.resumes for each in hit),
            sum(each.session.stats.reopenings for each in hit),
        )
        changed, ended = (
            sum(each.changed for each in cast.characters),
            [each.ended for each in cast.characters if each.ended],
        )
        unanswered = sum(each.unanswered for each in cast.characters)
        still_away = sum(len(each.lost_at) > len(each.back_at) for each in cast.characters)
        print(f"lost their connection:                {len(hit)} of {len(cast.characters)}")
        print(
            f"resumed:                              {resumed} times; reopened: {anew} times; still away: {still_away}"
        )
        print(f"without a server, p50 / p99 / max:    {percentile(away, 0.5):.2f} / {percentile(away, 0.99):.2f} / "
              f"{max(away, default=0.0):.2f} s")  # fmt: skip
        print(f"frames not in time, of those / all:   {sum(of_hit)} / {sum(missed)} of "
              f"{sum(each.shown for each in cast.characters)} shown")  # fmt: skip
        print(f"characters that froze for a moment:   {sum(count > 0 for count in of_hit)}")
        print(f"committed frames that changed:        {changed}")
        print(f"edits answered / refused or lost:     {sum(each.answered for each in cast.characters)} / {unanswered}")
        print(f"characters that ended:                {len(ended)} {ended[:1] or ''}")
        return not (changed or ended or unanswered or still_away)


def main() -> int:
    """Returns the exit code: 0 if no event was lost, no committed frame changed, and all characters play on."""
    names = [each.name for each in PROXIES]
    parser = argparse.ArgumentParser(prog="make scale-demo", description=__doc__)
    parser.add_argument("--characters", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=12.0, help="playing time after the kill")
    parser.add_argument("--proxy", choices=names, default=names[0])
    parser.add_argument("--how", choices=("kill", "drain"), default="kill")
    parser.add_argument("--null", action="store_true", help="servers without a model, for a busy machine")
    options = parser.parse_args()
    program = NULL_SERVER if options.null else SERVER
    with tempfile.TemporaryDirectory(prefix="scale-") as name:
        folder = Path(name)
        try:
            with (
                Replicas(folder, 2, program=program) as replicas,
                PROXIES[names.index(options.proxy)](folder, replicas.behind) as proxy,
            ):
                print(f"two servers behind {proxy.name} on {proxy.address}, sessions in {replicas.store}", flush=True)
                return 0 if asyncio.run(play(proxy.address, replicas, options)) else 1
        except Missing as missing:
            print(f"error: {missing}", file=sys.stderr)
            return 2


if __name__ == "__main__":
    sys.exit(main())
