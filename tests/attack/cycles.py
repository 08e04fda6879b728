"""How much memory a session leaves behind: `python -m tests.attack.cycles [--cycles N] [--model none|tiny|built-in]`.

Sessions are opened, edited and closed, a few at a time, while the resident memory of each server process is read.
Prints its slope in bytes per cycle; exits with code 1 if that is more than allowed. Resident memory says something only
after some ten thousand cycles, memory in use (`--in-use`) after some hundreds.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import math
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import grpc.aio
import numpy as np
import psutil

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.in_use import told
from tests.attack.server import BUILT_IN, MIB, NULL, Attacked, attacked
from tests.conftest import TINY_MODEL

AT_ONCE = 16
PARTS = 20
MOST_BYTES = 50
"""Allowed growth per cycle, of each process."""
STEP_BYTES = 128 << 10
"""For `Readings.slopes` over memory in use. The first batch of a new size makes megabytes be kept for later ones, once.
A leak of 2 KB a cycle is 24 KB from one reading to the next with the model. A leak of rare, large blocks is found only
by longer runs."""
SETTINGS = ("--stream-events-per-second", "1000000", "--peer-events-per-second", "1000000", "--admit-load", "1000",
            "--degrade", "false", "--profile-s", "1", "--loop-share", "1000000000")  # fmt: skip
MODELS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "none": (NULL, ()),
    "tiny": (BUILT_IN, ("--model", str(TINY_MODEL), "--text-encoder", "hashed")),
    "built-in": (BUILT_IN, ()),
}
"""The server's module and settings, by model; with "none", nothing is computed."""
Event = session_pb2.SessionEvent


class Cycles:
    """One stream on which sessions come and go."""

    def __init__(self, address: str) -> None:
        self.count = 0
        self._handles = itertools.count(1)
        self._channel = grpc.aio.insecure_channel(address)
        self._call = service_pb2_grpc.MotionServiceStub(self._channel).StreamMotion()

    async def run(self, cycles: int) -> None:
        """Run so many more cycles."""
        if not self.count:
            await self._call.write(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()))
        end = self.count + cycles
        under_way: set[int] = set()
        while self.count < end:
            while len(under_way) < AT_ONCE and self.count + len(under_way) < end:
                handle = next(self._handles)
                under_way.add(handle)
                await self._call.write(service_pb2.StreamMotionRequest(events=[
                    Event(session=handle, event_seq=1, open=session_pb2.OpenSession(seed=handle, denoise_steps=2))
                ]))  # fmt: skip
            response = await self._call.read()
            assert isinstance(response, service_pb2.StreamMotionResponse)
            for update in response.updates:
                if update.HasField("chunk") and update.chunk.first_frame == 0:
                    span = motion_pb2.PromptSpan(prompt_id=1, text=f"a person walks {update.session % 50}")
                    edit = session_pb2.EditPrompts(upsert=[span])
                    await self._call.write(service_pb2.StreamMotionRequest(events=[
                        Event(session=update.session, event_seq=2, edit_prompts=edit),
                        Event(session=update.session, event_seq=3, close=session_pb2.CloseSession()),
                    ]))  # fmt: skip
                elif update.HasField("closed") or (update.HasField("outcome") and update.outcome.event_seq == 1):
                    under_way.discard(update.session)
                    self.count += 1

    async def end(self) -> None:
        self._call.cancel()
        await self._channel.close()


@dataclass(frozen=True)
class Readings:
    """Memory of a server's processes, gateway first, after so many cycles: (readings,) and (readings, processes)."""

    cycles: list[int]
    values: list[list[int]]

    def slopes(self, step_bytes: float = math.inf) -> list[float]:
        """Each process's growth in bytes per cycle, after the first half: the median slope over all pairs of readings.

        So a reading that is off because of a cache, or the end of a rest, counts little. step_bytes: by how much the
        change between two readings may exceed the usual change; a larger jump is a cache that was filled at once, and
        counts as a usual change. A leak grows in every part.
        """
        half = len(self.cycles) // 2
        grown = np.diff(np.array(self.values[half:], float), axis=0)
        mostly = np.median(grown, axis=0)
        grown = np.where(np.abs(grown - mostly) > step_bytes, mostly, grown)
        table = np.vstack([np.zeros_like(mostly), np.cumsum(grown, axis=0)])
        pairs = list(itertools.combinations(range(len(table)), 2))
        cycles = self.cycles[half:]
        steps = [(table[after] - table[before]) / (cycles[after] - cycles[before]) for before, after in pairs]
        return [float(slope) for slope in np.median(steps, axis=0)]


def resident_bytes(pid: int) -> int:
    """Resident memory of a process."""
    return int(psutil.Process(pid).memory_info().rss)


async def measure(
    server: Attacked, cycles: int, bytes_of: Callable[[int], int] = resident_bytes, parts: int = PARTS
) -> Readings:
    """Run so many cycles, in parts, and read memory after each, when all sessions are closed. bytes_of: reads it."""
    client = Cycles(server.address)
    readings = Readings([], [])
    begun_s = time.perf_counter()
    for part in range(1, parts + 1):
        await client.run(part * cycles // parts - client.count)
        processes = (server.process, *server.process.children())
        readings.cycles.append(client.count)
        readings.values.append([bytes_of(each.pid) for each in processes])
        mib = " ".join(f"{value / MIB:.2f}" for value in readings.values[-1])
        print(f"{client.count} cycles, {time.perf_counter() - begun_s:.0f} s: {mib} MiB", flush=True)
    await client.end()
    return readings


def judged(readings: Readings) -> tuple[str, bool]:
    """The slopes in words, and whether they are within the bound."""
    slopes = readings.slopes()
    grown = ", ".join(f"{slope:.0f}" for slope in slopes)
    return f"bytes per cycle, gateway and engines: {grown}; allowed: {MOST_BYTES}", max(slopes) <= MOST_BYTES


async def main() -> int:
    """Returns the exit code: 1 if a process grows by more than is allowed."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack.cycles", description=__doc__)
    parser.add_argument("--cycles", type=int, default=100_000, help="default: %(default)s")
    parser.add_argument("--model", choices=MODELS, default="none", help="what is served (default: %(default)s)")
    parser.add_argument("--in-use", action="store_true", help="read memory in use, instead of resident memory")
    options = parser.parse_args()
    module, settings = MODELS[options.model]
    with contextlib.ExitStack() as context:
        log = Path(context.enter_context(tempfile.TemporaryDirectory())) / "log"
        in_use = context.enter_context(told()) if options.in_use else None
        bytes_of, environment = (in_use.bytes_of, in_use.environment) if in_use else (resident_bytes, None)
        server = context.enter_context(attacked(log, SETTINGS + settings, module=module, environment=environment))
        text, holds = judged(await measure(server, options.cycles, bytes_of))
    print(text)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
