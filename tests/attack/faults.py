"""What clients notice when a process is stopped or killed, or when the disk is full.

    python -m tests.attack.faults [--only WORDS ...] [--times N]

Prints a table of faults, each on a new server. Exits with code 1 if more sessions were lost than necessary, if the
others did not play on in full, or if the server did not end with exit code 0. Takes some fifteen seconds per fault.
"""

from __future__ import annotations

import argparse
import asyncio
import resource
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

import grpc.aio
import psutil

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.attack import machine
from tests.attack.neighbours import Noticed, neighbours
from tests.attack.server import Attacked, attacked
from tests.bench.processes import below
from tests.waiting import LIMIT_S, until_true

BEFORE_S = 2.0
STOPPED_S = 5.0
AFTER_S = 3.0
MISSED = 0.01
FULL_DISK_BYTES = 4096
NEW_PROMPTS = 40
ANSWERED = 30
NOT_KEPT = "cannot be used"
"""What the log says about a prompt store after a write to it has failed."""


async def stop(process: psutil.Process) -> None:
    """Stop a process for a while with SIGSTOP, like a machine that swaps or a debugger."""
    process.suspend()
    try:
        await asyncio.sleep(STOPPED_S)
    finally:
        process.resume()


async def stop_engine(server: Attacked) -> None:
    await stop(server.engines()[0])


async def stop_gateway(server: Attacked) -> None:
    await stop(server.process)


async def kill_engine(server: Attacked) -> None:
    """Send SIGKILL, as the kernel does when memory is short."""
    engine = server.engines()[0]
    engine.kill()
    await asyncio.to_thread(psutil.wait_procs, [engine], 10.0)


async def fill_disk(server: Attacked) -> None:
    """Let no file of the server grow any more, including the prompt store and its log; then send new prompts.

    Raises RuntimeError if these are not answered, TimeoutError if the store does not report a failure.
    """
    for process in (server.process, *below(server.process)):
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (FULL_DISK_BYTES, FULL_DISK_BYTES))
    async with grpc.aio.insecure_channel(server.address) as channel:
        call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
        events = [session_pb2.SessionEvent(session=1, event_seq=1, open=session_pb2.OpenSession())]
        for number in range(NEW_PROMPTS):
            span = motion_pb2.PromptSpan(prompt_id=1, text=f"a person does {number} things that nobody has done")
            edit = session_pb2.EditPrompts(upsert=[span])
            events.append(session_pb2.SessionEvent(session=1, event_seq=2 + number, edit_prompts=edit))
        answered = 0
        await call.write(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello(), events=events))
        while answered < ANSWERED and isinstance(response := await call.read(), service_pb2.StreamMotionResponse):
            answered += sum(update.HasField("outcome") for update in response.updates)
        call.cancel()
    if answered < ANSWERED:
        raise RuntimeError(f"{answered} prompts were answered while no file could grow, not {ANSWERED}")
    async with asyncio.timeout(LIMIT_S):
        await until_true(lambda: NOT_KEPT in server.log.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Fault:
    """act: causes the fault, and undoes it if possible. lost: how many sessions end with it.

    engines: the server's number of engine processes.
    """

    name: str
    act: Callable[[Attacked], Awaitable[None]]
    lost: int = 0
    engines: int = 1
    settings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """again_s: from the fault's end until all remaining sessions play. open_s: until new ones do. noticed: later."""

    fault: Fault
    again_s: float
    open_s: float
    noticed: Noticed
    exit_code: int | None

    @property
    def wrong(self) -> list[str]:
        """What should not have happened, in words."""
        lost = len(self.noticed.closed)
        found = {
            f"{lost} sessions were lost, not {self.fault.lost}": lost != self.fault.lost,
            f"{self.noticed.missed:.1%} of the frames were missed afterwards": self.noticed.missed > MISSED,
            f"the server ended with {self.exit_code}": self.exit_code != 0,
        }
        return [what for what, holds in found.items() if holds]


async def run(fault: Fault, folder: Path, after_s: float = AFTER_S) -> Outcome:
    """Cause one fault, on a new server."""
    settings = tuple(setting.replace("FOLDER", str(folder)) for setting in fault.settings)
    with attacked(folder / "log", settings) as server:
        engines = [each.pid for each in server.engines()]
        if len(engines) != fault.engines:
            raise RuntimeError(f"the server has {len(engines)} engine processes, not {fault.engines}")
        async with neighbours(server.address, engines=engines) as good:
            await asyncio.sleep(BEFORE_S)
            await fault.act(server)
            again_s = await good.again_s()
            begun_s = time.perf_counter()
            async with neighbours(server.address, 1):
                open_s = time.perf_counter() - begun_s
            good.forget()
            await asyncio.sleep(after_s)
            noticed = good.noticed()
    return Outcome(fault, again_s, open_s, noticed, server.exit_code)


FAULTS = (
    Fault(f"engine process stopped for {STOPPED_S:g} s (SIGSTOP)", stop_engine),
    Fault(f"gateway stopped for {STOPPED_S:g} s (SIGSTOP)", stop_gateway),
    Fault("one of two engine processes killed (SIGKILL)", kill_engine, lost=6, engines=2,
          settings=("--devices", "cpu:2")),
    Fault("no file can grow (disk full), new prompts for the store", fill_disk,
          settings=("--prompt-store", "FOLDER/prompts.db")),
)  # fmt: skip


def table(outcomes: list[Outcome]) -> str:
    """A Markdown table with a row for each fault."""
    lines = [
        "| fault | sessions lost of 12 | others play again after | new ones after | frames missed then | exit code "
        "| verdict |",
        "|---|---:|---:|---:|---:|---:|---|",
    ]
    for each in outcomes:
        lines.append(
            f"| {each.fault.name} | {len(each.noticed.closed)} | {each.again_s:.2f} s | {each.open_s:.2f} s "
            f"| {each.noticed.missed:.1%} | {each.exit_code} | {'; '.join(each.wrong) or 'held'} |"
        )
    return "\n".join(lines) + "\n"


async def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.attack.faults", description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], metavar="WORD", help="faults whose name contains one of these")
    parser.add_argument("--times", type=int, default=1, help="of each fault (default: %(default)s)")
    options = parser.parse_args()
    outcomes = []
    for fault in FAULTS:
        if options.only and not any(word in fault.name for word in options.only):
            continue
        for _ in range(options.times):
            with tempfile.TemporaryDirectory() as folder:
                outcomes.append(await run(fault, Path(folder)))
            print(f"{fault.name}: {'; '.join(outcomes[-1].wrong) or 'held'}", flush=True)
    print(f"{table(outcomes)}\n{machine()}")
    return 1 if any(each.wrong for each in outcomes) else 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
