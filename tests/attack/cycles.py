"""What memory a session leaves behind: `python -m tests.attack.cycles [--cycles N] [--built-in]`.

Sessions are opened, edited and closed, some at a time; resident memory is noted along the way, of each process of the
server, and its slope is told in bytes a cycle.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import sys
import tempfile
import time
from pathlib import Path

import grpc.aio
import numpy as np

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.server import BUILT_IN, NULL, Attacked, attacked

AT_ONCE = 16
SETTINGS = ("--stream-events-per-second", "1000000", "--peer-events-per-second", "1000000", "--admit-load", "1000",
            "--degrade", "false", "--profile-s", "1")  # fmt: skip
Event = session_pb2.SessionEvent


class Cycles:
    """One stream on which sessions come and go."""

    def __init__(self, address: str) -> None:
        self.count = 0
        self._handles = itertools.count(1)
        self._channel = grpc.aio.insecure_channel(address)
        self._call = service_pb2_grpc.MotionServiceStub(self._channel).StreamMotion()
        self._seen: dict[int, asyncio.Event] = {}

    async def run(self, cycles: int) -> None:
        """So many more of them."""
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


def memories(server: Attacked) -> list[int]:
    """Resident bytes: of the gateway, then of each engine process."""
    return [each.memory_info().rss for each in (server.process, *server.process.children())]


async def measure(server: Attacked, cycles: int) -> list[float]:
    """Bytes a cycle that each process grows by, from a line through the later half of what was noted."""
    client = Cycles(server.address)
    noted = []
    part = max(1, cycles // 20)
    begun_s = time.perf_counter()
    for _ in range(20):
        await client.run(part)
        noted.append((client.count, *memories(server)))
        mib = " ".join(f"{rss / (1 << 20):.1f}" for rss in noted[-1][1:])
        print(f"{client.count} cycles, {time.perf_counter() - begun_s:.0f} s: {mib} MiB", flush=True)
    await client.end()
    table = np.array(noted[len(noted) // 2 :], float)
    return [float(np.polyfit(table[:, 0], table[:, column], 1)[0]) for column in range(1, table.shape[1])]


async def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.attack.cycles", description=__doc__)
    parser.add_argument("--cycles", type=int, default=20_000, help="default: %(default)s")
    parser.add_argument("--built-in", action="store_true", help="with the built-in model (default: nothing computed)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        module = BUILT_IN if options.built_in else NULL
        with attacked(Path(folder) / "log", SETTINGS, module=module) as server:
            slopes = await measure(server, options.cycles)
    print("bytes a cycle, gateway and engines: " + ", ".join(f"{slope:.0f}" for slope in slopes))
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
