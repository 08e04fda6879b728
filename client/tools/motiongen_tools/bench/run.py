"""One run: start the processes together, follow them, and merge their measurements."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime

from motiongen_client.errors import InvalidInput
from motiongen_client.types import Model
from motiongen_tools.bench.load import Load, Progress
from motiongen_tools.bench.machine import machine_facts
from motiongen_tools.bench.programs import Programs
from motiongen_tools.bench.result import Result, Standard, merge_reports
from motiongen_tools.bench.server_use import ServerUse, ServerWatch
from motiongen_tools.bench.workers import Workers


async def run_load(
    load: Load,
    tell: Callable[[Progress], None],
    standard: Standard,
    server_pid: int | None = None,
    ops_address: str = "",
) -> Result:
    """Play a load and measure. tell: called once a second for each process.

    server_pid: a server process to watch; ops_address: host:port of its metrics, if these are to be read too.

    Raises InvalidInput for steps that the model cannot do, ServerUnavailable, GeneratorFailed.
    """
    async with load.connection.client(load.address) as client:
        catalog = client.catalog
    _check_steps(load, catalog.models[0])
    schedule = load.schedule()
    watch = None if server_pid is None else ServerWatch(server_pid, ops_address)
    async with Workers(load) if load.program is None else Programs(load, catalog) as workers:
        await workers.ready()
        started_at = datetime.now(UTC)
        start_at_s = await workers.go()
        watching = _nothing() if watch is None else watch.follow(start_at_s, schedule.phases)
        reports, use = await asyncio.gather(workers.reports(tell), watching)
    return Result(
        started_at=started_at.isoformat(timespec="seconds"),
        load=load,
        schedule_sha256=schedule.sha256(),
        phases=schedule.phases,
        server=_server_facts(load, catalog.models[0]),
        machine=machine_facts(),
        streams=sum(report.streams for report in reports),
        recorder=merge_reports(load.new_book(schedule.phases), reports),
        generator_cores=tuple(report.cpu_s / schedule.phases.measure_s for report in reports),
        server_use=use,
        standard=standard,
        program=reports[0].program,
    )


async def _nothing() -> ServerUse | None:
    return None


def _check_steps(load: Load, model: Model) -> None:
    steps = load.denoise_steps
    if steps is not None and not model.min_denoise_steps <= steps <= model.max_denoise_steps:
        allowed = f"{model.min_denoise_steps} to {model.max_denoise_steps}, which is what {model.model_id} can do"
        raise InvalidInput("denoise_steps", steps, allowed)


def _server_facts(load: Load, model: Model) -> dict[str, str]:
    return {
        "address": load.address,
        "model": model.model_id,
        "text encoder": model.text_encoder,
        "denoising steps": str(load.denoise_steps or model.default_denoise_steps),
        "horizon": f"{model.horizon_frames} frames",
    }
