"""motiongen-load instead of generator processes: a program in C++ that plays the same load.

The load is drawn and judged here; the program receives it as a line of JSON (client/cpp/load/load.proto).
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from motiongen.v1 import session_pb2
from motiongen_client.types import Catalog
from motiongen_tools.bench.character import make_jitter
from motiongen_tools.bench.load import GeneratorFailed, Load, Progress, Report
from motiongen_tools.bench.recorder import PackedBook, new_histogram
from motiongen_tools.bench.schedule import Schedule
from motiongen_tools.connection import PLAIN, Connection

_HEAD_START_S = 0.3
_READY_TIMEOUT_S = 60.0
_SILENCE_TIMEOUT_S = 60.0  # a program reports its progress every second
_END_TIMEOUT_S = 10.0
_MOST_LINE_BYTES = 64 << 20
_MESSAGES = ("ready", "progress", "book", "failed")  # what a program may send: Told in load.proto


class Programs:
    """The programs of one run; interface as `Workers`. Use it as `async with`, so that none is left running."""

    def __init__(self, load: Load, catalog: Catalog) -> None:
        self._load = load
        self._catalog = catalog
        self._processes: list[Process] = []
        self._names: list[str] = []

    async def ready(self) -> None:
        """Start the programs, and wait until all are connected. Raises GeneratorFailed."""
        load, schedule = self._load, self._load.schedule()
        for number in range(load.processes):
            try:
                process = await asyncio.create_subprocess_exec(
                    str(load.program), stdin=PIPE, stdout=PIPE, limit=_MOST_LINE_BYTES
                )
            except OSError as error:
                raise GeneratorFailed(f"{load.program} cannot be run: {error.strerror}") from None
            self._processes.append(process)
            await _say(process, describe(load, schedule, self._catalog, number))
        told = [await self._hear(process, _READY_TIMEOUT_S) for process in self._processes]
        self._names = [message["ready"]["program"] for message in told]

    async def go(self) -> float:
        """Start the run. Returns its starting time, on time.monotonic."""
        start_at_s = time.monotonic() + _HEAD_START_S
        for process in self._processes:
            await _say(process, {"start_at_s": start_at_s})
        return start_at_s

    async def reports(self, tell: Callable[[Progress], None]) -> list[Report]:
        """Wait for all reports. tell: called once a second for each. Raises GeneratorFailed."""
        return await asyncio.gather(*(self._report(number, tell) for number in range(len(self._processes))))

    async def _report(self, number: int, tell: Callable[[Progress], None]) -> Report:
        while True:
            message = await self._hear(self._processes[number], _SILENCE_TIMEOUT_S)
            if "book" in message:
                book = message["book"]
                return Report(number, read_book(book), book["cpu_s"], book["streams"], self._names[number])
            progress = message["progress"]
            counts = {name: int(progress[name]) for name in ("playing", "missed", "edits", "refused")}
            tell(Progress(number, progress["at_s"], **counts))

    async def _hear(self, process: Process, timeout_s: float) -> dict[str, Any]:
        """The next message. Raises GeneratorFailed for a reported error, silence, or an end without a report."""
        assert process.stdout is not None
        try:
            line = await asyncio.wait_for(process.stdout.readline(), timeout_s)
        except TimeoutError:
            raise GeneratorFailed(f"{self._load.program} said nothing for {timeout_s:g} s") from None
        try:
            message: Any = json.loads(line)
        except ValueError:
            message = None
        if not isinstance(message, dict) or message.keys().isdisjoint(_MESSAGES):
            raise GeneratorFailed(
                f"{self._load.program} ended without a report, or is no motiongen-load: it said {line[:80]!r}"
            )
        if "failed" in message:
            raise GeneratorFailed(message["failed"])
        return message

    async def __aenter__(self) -> Programs:
        return self

    async def __aexit__(self, failure: type[BaseException] | None, *_: object) -> None:
        for process in self._processes:
            if failure is not None and process.returncode is None:
                process.kill()
            try:
                await asyncio.wait_for(process.communicate(), _END_TIMEOUT_S)
            except TimeoutError:
                process.kill()
                await process.wait()


async def _say(process: Process, message: dict[str, Any]) -> None:
    assert process.stdin is not None
    process.stdin.write(json.dumps(message).encode() + b"\n")
    with contextlib.suppress(ConnectionError):  # it has ended; its last message is read next
        await process.stdin.drain()


def describe(load: Load, schedule: Schedule, catalog: Catalog, process: int) -> dict[str, Any]:
    """The message Load of load.proto."""
    phases = schedule.phases
    message: dict[str, Any] = {
        "address": load.address,
        "process": process,
        "num_processes": load.processes,
        "num_streams": load.num_streams(schedule, catalog.limits.max_sessions_per_stream),
        "max_request_bytes": catalog.limits.max_request_bytes,
        "frame_rate": catalog.rigs[0].frame_rate_hz,
        "patch_frames": catalog.models[0].patch_frames,
        "report_hz": load.scenario.report_hz,
        "measure_from_s": phases.measure_from_s,
        "measure_to_s": phases.measure_to_s,
        "end_s": phases.end_s,
        "groups": [
            {
                "name": group.name,
                "priority": session_pb2.PriorityClass.Value(f"PRIORITY_CLASS_{group.priority.name}"),
                "prompts": group.prompts,
                "rules": [{k: v for k, v in asdict(rule).items() if k != "timing"} for rule in group.edits],
            }
            for group in load.scenario.groups
        ],
        "characters": [
            {"group": plan.group, "open_s": plan.open_s, "seed": str(plan.seed), "prompt": plan.prompt}
            | ({"close_s": plan.close_s} if plan.close_s < math.inf else {})
            for plan in schedule.characters
        ],
        "edit_at_s": schedule.edit_at_s.tolist(),
        "edit_character": schedule.edit_character.tolist(),
        "edit_rule": schedule.edit_rule.tolist(),
        "edit_value": schedule.edit_value.tolist(),
        "jitter_s": make_jitter(),
    }
    if load.denoise_steps is not None:
        message["denoise_steps"] = load.denoise_steps
    if load.connection != PLAIN:
        message["access"] = _access(load.connection)
    return message


def _access(connection: Connection) -> dict[str, Any]:
    """The message Access of load.proto. Raises InvalidInput for a file that cannot be read."""
    pem = connection.pem()
    return {
        "tls": connection.tls,
        "root_certificates": pem.authorities.decode(errors="replace"),
        "certificate_chain": pem.certificate.decode(errors="replace"),
        "private_key": pem.key.decode(errors="replace"),
        "token": "" if connection.token_file is None else connection.token(),
    }


def read_book(book: dict[str, Any]) -> PackedBook:
    """What a program measured, in the form that the processes of `workers` report it."""
    histograms = {}
    for latencies in book["latencies"]:
        histogram = new_histogram()
        for value_us, count in zip(latencies["value_us"], latencies["count"], strict=True):
            histogram.record_value(value_us, int(count))
        histograms[latencies["what"], latencies["group"]] = bytes(histogram.encode())
    seconds: dict[str, dict[str, list[float]]] = {}
    for row in book["seconds"]:
        seconds.setdefault(row["what"], {})[row["group"]] = row["amount"]
    return PackedBook(histograms, {name: int(count) for name, count in book["counts"].items()}, seconds)
