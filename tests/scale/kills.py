"""What characters notice when processes are killed: `python -m tests.scale.kills [--times N] [--seed S]`.

Two servers with a shared text encoder, a Redis and a proxy, all real. Characters play in real time with two seconds of
look-ahead, and are edited every few seconds. SIGKILL repeatedly ends one of: a gateway (with its engine), an engine
process, the encoder, the Redis, the proxy; which, of which server, and when is drawn from the seed. The process is
restarted at once, as by an orchestrator, and the next kill waits until everything works again: one failure at a time.
`FOLDER/kills.jsonl` has a line for each kill; the same command with --go-on adds to it. Prints a table, and exits with
code 1 if an event was lost, a committed frame changed, or a character did not come back or took too long.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import signal
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tests.scale.characters import Cast, Character, percentile
from tests.scale.processes import Encoder
from tests.scale.proxies import CERTIFICATES, PROXIES, Missing, Proxy
from tests.scale.replicas import NULL_SERVER, SERVER, Replica, Replicas

KINDS = ("gateway", "engine", "encoder", "redis", "proxy")
LIVE_S, SNAPSHOT_S = 1.0, 3.0
"""Bounds on the 99th percentile of the time that characters are without a server, if theirs lives on and if not."""
BACK_S = 60.0
"""After this time a character counts as one that did not come back."""
SETTLED_S = 3.0
"""The least time between kills: by then every session has been saved again."""


COUNTED = ("missed", "changed", "unanswered", "not_back")


@dataclass(frozen=True)
class Kill:
    """A kill, and what was noticed until the next. away_s: of each character that lost its connection; missed: frames.

    down_s: until the killed process had started again; for servers, which take longer, until their start began.
    """

    number: int
    what: str
    victim: str
    away_s: tuple[float, ...]
    resumed: int
    anew: int
    missed: int
    changed: int
    unanswered: int
    not_back: int
    down_s: float = 0.0
    ended: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class Books:
    """Totals of what characters have noticed so far."""

    missed: int
    changed: int
    unanswered: int
    resumed: int
    anew: int

    @classmethod
    def of(cls, characters: list[Character]) -> Books:
        return cls(
            sum(each.underruns for each in characters),
            sum(each.changed for each in characters),
            sum(each.unanswered for each in characters),
            sum(each.session.stats.resumes for each in characters),
            sum(each.session.stats.reopenings for each in characters),
        )


class World:
    """Everything that can be killed, and the characters that notice it."""

    def __init__(self, replicas: Replicas, proxy: Proxy, encoder: Encoder, cast: Cast, draw: random.Random) -> None:
        self._replicas, self._proxy, self._encoder, self._cast = replicas, proxy, encoder, cast
        self._draw = draw

    async def kill(self, number: int, what: str) -> Kill:
        """Kill one process at a random moment, start it again, and wait until everything works."""
        characters = self._cast.characters
        await asyncio.sleep(self._draw.uniform(0.0, 2.0))
        replica = self._draw.choice(await asyncio.to_thread(self._serving))
        before, killed_at = Books.of(characters), time.monotonic()
        victim = await asyncio.to_thread(self._end_and_start, what, replica)
        down_s = round(time.monotonic() - killed_at, 3)
        not_back = await self._until_well(killed_at)
        after = Books.of(characters)
        return Kill(
            number, what, victim,
            tuple(round(s, 3) for each in characters for s in each.away_s(killed_at)),
            after.resumed - before.resumed, after.anew - before.anew, after.missed - before.missed,
            after.changed - before.changed, after.unanswered - before.unanswered, not_back, down_s,
            tuple(each.ended for each in characters if each.ended),
        )  # fmt: skip

    def _end_and_start(self, what: str, replica: Replica) -> str:
        if what == "gateway":
            replica.kill()
            replica.begin()
            return replica.name
        if what == "engine":
            replica.kill_engine()  # its gateway restarts it
            return replica.name
        if what == "encoder":
            self._encoder.kill()
            self._encoder.begin()
        elif what == "redis":
            self._replicas.kill_redis()
            self._replicas.start_redis()
        elif what == "proxy":
            self._proxy.kill()
            self._proxy.start()
        return what

    async def _until_well(self, killed_at: float) -> int:
        """Wait until everything works. Returns how many characters were not back within BACK_S."""
        not_back = 0
        while True:
            away = [each for each in self._cast.characters if not each.ended and each.is_away]
            waited_s = time.monotonic() - killed_at
            is_well = not away and waited_s > SETTLED_S and await asyncio.to_thread(self._is_well)
            if waited_s > BACK_S and away:
                not_back = len(away)
            if is_well or waited_s > 2 * BACK_S:
                return not_back
            await asyncio.sleep(0.1)

    def _serving(self) -> list[Replica]:
        """The servers that have sessions."""
        return [each for each in self._replicas.all if each.metric("motiongen_sessions")] or self._replicas.all

    def _is_well(self) -> bool:
        for replica in self._replicas.all:
            if not replica.is_running:  # it gave up on its engine; restart it, as an orchestrator does
                replica.begin()
        ready = all(replica.is_ready for replica in self._replicas.all)
        saving = all(replica.metric("motiongen_snapshot_store_up") == 1 for replica in self._replicas.all)
        return ready and saving and self._encoder.is_ready


def order(times: int, seed: int, kinds: list[str]) -> list[str]:
    """The kinds of processes to kill: each as often as the others, in random order."""
    drawn = [kinds[number % len(kinds)] for number in range(times)]
    random.Random(seed).shuffle(drawn)
    return drawn


def report(kills: list[Kill]) -> int:
    """Print the results of all kills. Returns the exit code."""
    print("| killed | times | connections lost | resumed / reopened | without a server: p50 / p99 / most | "
          "frames missed | committed frames changed | events lost | not back |")  # fmt: skip
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    faults = []
    for what in (*KINDS, "all"):
        chosen = [each for each in kills if what in (each.what, "all")]
        if not chosen:
            continue
        away = [s for each in chosen for s in each.away_s]
        p99 = percentile(away, 0.99)
        resumed, anew = sum(each.resumed for each in chosen), sum(each.anew for each in chosen)
        p50, most = percentile(away, 0.5), max(away, default=0.0)
        sums = [sum(getattr(each, name) for each in chosen) for name in COUNTED]
        print(f"| {what} | {len(chosen)} | {len(away)} | {resumed} / {anew} | {p50:.2f} / {p99:.2f} / {most:.2f} s | "
              f"{' | '.join(map(str, sums))} |")  # fmt: skip
        allowed = SNAPSHOT_S if what in ("gateway", "engine", "all") else LIVE_S
        if p99 > allowed:
            faults.append(f"{what}: the 99th percentile was {p99:.2f} s, at most {allowed:g} s are allowed")
        if anew:
            faults.append(f"{what}: {anew} sessions were reopened")
    for name in COUNTED:
        count = sum(getattr(each, name) for each in kills)
        if count:
            faults.append(f"{name.replace('_', ' ')}: {count}")
    faults += sorted({f"a character ended: {why}" for each in kills for why in each.ended})
    print("\n".join(f"DOES NOT HOLD: {fault}" for fault in faults) or "all bounds hold")
    return 1 if faults else 0


def read(path: Path) -> list[Kill]:
    """The kills in a file; none if it does not exist."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    told = [json.loads(line) for line in lines]
    return [Kill(**{**each, "away_s": tuple(each["away_s"]), "ended": tuple(each["ended"])}) for each in told]


async def play(address: str, replicas: Replicas, proxy: Proxy, encoder: Encoder, options: argparse.Namespace) -> None:
    path = options.out / "kills.jsonl"
    begin = len(read(path))
    ends_at = time.monotonic() + 60 * options.minutes
    async with Cast(address, options.characters, CERTIFICATES / "authority.pem") as cast:
        await asyncio.sleep(2 * SETTLED_S)
        world = World(replicas, proxy, encoder, cast, random.Random(f"{options.seed} {begin}"))
        for number, what in enumerate(order(options.times, options.seed, options.kinds)):
            if number < begin or time.monotonic() > ends_at:
                continue
            kill = await world.kill(number, what)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(kill)) + "\n")
            most = max(kill.away_s, default=0.0)
            lost = f"{len(kill.away_s)} lost their connection, for up to {most:.2f} s"
            started = f"started again after {kill.down_s:.2f} s"
            print(f"{number + 1}. {what} ({kill.victim}), {started}: {lost}; {kill.missed} missed", flush=True)
            if kill.ended:
                break
        put_off = sum(each.put_off for each in cast.characters)
        print(f"edits with new prompts that were refused while the encoder was down: {put_off}", flush=True)


def main() -> int:
    names = [each.name for each in PROXIES]
    parser = argparse.ArgumentParser(prog="python -m tests.scale.kills", description=__doc__)
    parser.add_argument("--times", type=int, default=100, help="total number of kills (default: %(default)s)")
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="after this time no more follow (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--characters", type=int, default=12, help="default: %(default)s")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="default: all")
    parser.add_argument("--proxy", choices=names, default=names[0], help="default: %(default)s")
    parser.add_argument("--null", action="store_true", help="servers without a model")
    parser.add_argument("--out", type=Path, default=Path("out/kills"), help="default: %(default)s")
    parser.add_argument("--go-on", action="store_true", help="add to the kills in --out")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "kills.jsonl"
    if not options.go_on:
        path.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        folder = Path(name)
        encoder = Encoder(folder)
        more = ("--text-encoder", f"grpc:127.0.0.1:{encoder.port}")
        program = NULL_SERVER if options.null else SERVER
        try:
            encoder.start()
            with (
                Replicas(folder, 2, more, program=program) as replicas,
                PROXIES[names.index(options.proxy)](folder, replicas.behind) as proxy,
            ):
                asyncio.run(play(proxy.address, replicas, proxy, encoder, options))
        except Missing as missing:
            print(f"error: {missing}", file=sys.stderr)
            return 2
        finally:
            encoder.stop()
    return report(read(path))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that everything is cleaned up
    sys.exit(main())
