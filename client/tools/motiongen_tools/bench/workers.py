"""Generator processes: started, set off together, and their reports collected."""

from __future__ import annotations

import asyncio
import multiprocessing
import signal
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from multiprocessing import connection as pipes
from multiprocessing.connection import Connection
from typing import Any

from motiongen_client.errors import MotiongenError
from motiongen_tools.bench.generator import Generator
from motiongen_tools.bench.load import GeneratorFailed, Load, Progress, Report

_HEAD_START_S = 0.3  # from "go" to the run's start, so that it reaches all processes
_READY_TIMEOUT_S = 60.0
_SILENCE_TIMEOUT_S = 60.0  # a process reports its progress every second
_END_TIMEOUT_S = 10.0


@dataclass(frozen=True)
class _Ready:
    process: int


@dataclass(frozen=True)
class _Failed:
    message: str


def work(load: Load, process: int, connection: Connection) -> None:
    """The body of a generator process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent decides
    try:
        asyncio.run(_work(load, process, connection))
    except MotiongenError as error:
        connection.send(_Failed(str(error)))
    except BrokenPipeError:
        pass  # the parent is gone, so there is nobody to report to


async def _work(load: Load, process: int, connection: Connection) -> None:
    async with load.connection.client(load.address) as client:
        generator = Generator(load, client.catalog, process)
    await generator.connect()
    connection.send(_Ready(process))
    start_at_s = await asyncio.to_thread(connection.recv)
    connection.send(await generator.play(start_at_s, connection.send))


class Workers:
    """The generator processes of one run. Use it as `async with`, so that none is left running."""

    def __init__(self, load: Load) -> None:
        context = multiprocessing.get_context("spawn")  # gRPC does not survive a fork
        self._connections: list[Connection] = []
        self._processes = []
        for process in range(load.processes):
            ours, theirs = context.Pipe()
            self._connections.append(ours)
            self._processes.append(context.Process(target=work, args=(load, process, theirs), daemon=True))
            self._processes[-1].start()
            theirs.close()

    async def ready(self) -> None:
        """Wait until all are connected. Raises GeneratorFailed."""
        waiting = set(range(len(self._processes)))
        async for process, _ in self._messages(waiting, _READY_TIMEOUT_S):
            waiting.remove(process)

    async def go(self) -> float:
        """Start the run. Returns its starting time, on time.monotonic."""
        start_at_s = time.monotonic() + _HEAD_START_S
        for connection in self._connections:
            connection.send(start_at_s)
        return start_at_s

    async def reports(self, tell: Callable[[Progress], None]) -> list[Report]:
        """Wait for all reports. tell: called once a second for each process. Raises GeneratorFailed."""
        reports: dict[int, Report] = {}
        waiting = set(range(len(self._processes)))
        async for process, message in self._messages(waiting, _SILENCE_TIMEOUT_S):
            if isinstance(message, Report):
                reports[process] = message
                waiting.remove(process)
            elif isinstance(message, Progress):
                tell(message)
        return [reports[process] for process in sorted(reports)]

    async def _messages(self, waiting: set[int], timeout_s: float) -> AsyncIterator[tuple[int, Any]]:
        """Messages of the processes in `waiting`, until the caller has emptied it. Raises GeneratorFailed."""
        while waiting:
            listening = {self._connections[process]: process for process in waiting}
            speaking = await asyncio.to_thread(pipes.wait, list(listening), timeout_s)
            if not speaking:
                raise GeneratorFailed(f"{len(waiting)} generator processes said nothing for {timeout_s:g} s")
            for connection in speaking:
                assert isinstance(connection, Connection)
                yield listening[connection], _receive(connection)

    async def __aenter__(self) -> Workers:
        return self

    async def __aexit__(self, failure: type[BaseException] | None, *_: object) -> None:
        for process in self._processes:
            if failure is not None:
                process.terminate()
            await asyncio.to_thread(process.join, _END_TIMEOUT_S)
            if process.is_alive():
                process.kill()
                process.join()
        for connection in self._connections:
            connection.close()


def _receive(connection: Connection) -> Any:
    """The next message. Raises GeneratorFailed if the process reported an error, or ended without a report."""
    try:
        message = connection.recv()
    except (EOFError, ConnectionResetError):
        raise GeneratorFailed("a generator process ended without a report; its error is above") from None
    if isinstance(message, _Failed):
        raise GeneratorFailed(message.message)
    return message
