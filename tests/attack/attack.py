"""One attack: its server, its hostile clients, what good clients noticed, and the bounds on that."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import grpc
import grpc.aio
import httpx
import psutil
from grpc_health.v1 import health_pb2, health_pb2_grpc

from tests.attack.hostile_clients import Clients
from tests.attack.neighbours import TIER_FULL, Noticed, neighbours
from tests.attack.newcomers import newcomers
from tests.attack.server import BUILT_IN, EVERY_CORE, NULL, SLOW_ENCODER, Attacked, attacked
from tests.attack.tokens import TOKEN_VARIABLE, Tokens, bearer

WARM_S = 1.0
HEALTH_S = 5.0
LONG_S = 3_600.0
MIB = 1 << 20


@dataclass(frozen=True)
class Attack:
    """What hostile clients do, and bounds on what their neighbours, the good clients, may notice.

    kind: of `tests.attack.hostile`, "" for none. missed: share of frames; edit_ms: 95th percentile; newcomer_s: how
    soon a session opened during the attack has frames; health_s: how soon a health check is answered; grown_mib: memory
    of all server processes; log_mib: growth of the log. at_ops: attacks the operations port. after: a kind of
    well-behaved clients that come and go first, so that memory that an engine needs for full batches is not counted.
    to_the_end: the attack goes on while the server is asked to end. takes_places: the hostile clients open as many
    sessions as they get, so that there may be no room for newcomers. slow_encoder: the text encoder is slow, and each
    edit of the neighbours has a new prompt. token_s: the server requires tokens, and that of the hostile clients is
    valid for so long after they have begun. elsewhere: they are another tenant and so, like clients of another address,
    another owner; sessions get their shares of a model by owner.
    """

    name: str
    kind: str
    clients: int = 1
    built_in: bool = False
    settings: tuple[str, ...] = ()
    most_files: int | None = None
    at_ops: bool = False
    missed: float = 0.01
    edit_ms: float = 1_000.0
    newcomer_s: float = 1.0
    health_s: float = HEALTH_S
    grown_mib: float = 200.0
    log_mib: float = 1.0
    after: str = ""
    to_the_end: bool = False
    takes_places: bool = False
    slow_encoder: bool = False
    token_s: float | None = None
    elsewhere: bool = False

    @property
    def module(self) -> tuple[str, ...]:
        """The module that its server is started from."""
        return BUILT_IN if self.built_in else SLOW_ENCODER if self.slow_encoder else NULL

    @property
    def server_settings(self) -> tuple[str, ...]:
        """Settings that differ from the usual ones."""
        return (*(EVERY_CORE if self.built_in else ()), *self.settings)


@dataclass(frozen=True)
class Suffered:
    """Effects of an attack. gateway_cpu: as a share of a core. quiet_noticed: noticed before the attack, if requested.

    grown_mib: growth during the attack; left_mib: after it. health_ms: of a health check during the attack. newcomers:
    of sessions opened during the attack, how many were served, refused (by reason), and still waiting.
    """

    noticed: Noticed
    newcomers: tuple[int, Counter[str], int]
    grown_mib: float
    left_mib: float
    health_ms: float
    gateway_cpu: float
    quiet_noticed: Noticed | None = None


@dataclass(frozen=True)
class Result:
    """The result of one attack. errors: internal errors of the server in its log."""

    attack: Attack
    suffered: Suffered
    log_mib: float
    exit_code: int | None
    errors: int = 0

    @property
    def noticed(self) -> Noticed:
        return self.suffered.noticed

    @property
    def faults(self) -> list[str]:
        """The bounds that were broken, in words."""
        attack, noticed, suffered = self.attack, self.noticed, self.suffered
        welcomed, refused, waiting = suffered.newcomers
        found = {
            f"newcomers were refused: {dict(refused)}": bool(refused) and not attack.takes_places,
            f"of newcomers {welcomed} were served and {waiting} waited": bool(waiting),
            f"{noticed.missed:.1%} of the frames were missed": noticed.missed > attack.missed,
            f"edits took {noticed.edit_p95_ms:.0f} ms": noticed.edit_p95_ms > attack.edit_ms,
            f"sessions were served at tier {noticed.lowest_tier}": noticed.lowest_tier != TIER_FULL,
            f"sessions ended: {noticed.closed}": bool(noticed.closed),
            f"memory grew by {suffered.grown_mib:.0f} MiB": suffered.grown_mib > attack.grown_mib,
            f"the log grew by {self.log_mib:.1f} MiB": self.log_mib > attack.log_mib,
            f"{self.errors} errors inside the server are in its log": bool(self.errors),
            "health was not answered": suffered.health_ms > 1000 * attack.health_s,
            f"the server ended with {self.exit_code}": self.exit_code != 0,
        }
        return [fault for fault, holds in found.items() if holds]


@contextmanager
def hostile(attack: Attack, server: Attacked, token: str = "") -> Iterator[Clients]:
    """Run the hostile clients until the end of the block. token: sent with their calls.

    Raises HostileClientEnded if one ends earlier.
    """
    at = f"127.0.0.1:{server.ops_port}" if attack.at_ops else server.address
    with Clients(attack.kind, at, attack.clients, {**os.environ, TOKEN_VARIABLE: token}) as clients:
        yield clients


async def health_ms(server: Attacked, by_http: bool, within_s: float = HEALTH_S) -> float:
    """How long a health check takes over a new connection; more than within_s if it is not answered.

    by_http: ask on the operations port, as orchestrators do; for attacks that use up the gRPC port's connections.
    """
    begun_s, address = time.perf_counter(), server.address
    if by_http:
        async with httpx.AsyncClient(timeout=within_s) as client:
            answer = await client.get(f"http://127.0.0.1:{server.ops_port}/readyz")
        return 1000 * (time.perf_counter() - begun_s) if answer.status_code == 200 else 2000 * within_s
    async with grpc.aio.insecure_channel(address, options=(("grpc.use_local_subchannel_pool", 1),)) as channel:
        try:
            stub: Any = health_pb2_grpc.HealthStub(channel)  # its stubs name no methods
            await stub.Check(health_pb2.HealthCheckRequest(), timeout=within_s)
        except grpc.aio.AioRpcError as error:
            print(f"the health check ended with {error.code().name}: {error.details()}", file=sys.stderr)
            return 2000 * within_s
    return 1000 * (time.perf_counter() - begun_s)


async def suffer(
    attack: Attack, server: Attacked, seconds: float, tokens: Tokens | None = None, quiet_s: float = 0.0
) -> Suffered:
    """Run the attack for so long. quiet_s: how long the neighbours are alone before it."""
    good_token = bearer(tokens.good) if tokens else ()
    playing = neighbours(server.address, new_prompts=attack.slow_encoder, metadata=good_token)
    async with playing as good, newcomers(server.address, good_token) as coming:
        await asyncio.sleep(WARM_S)
        quiet_noticed = None
        if quiet_s:
            good.forget()
            await asyncio.sleep(quiet_s)
            quiet_noticed = good.noticed()
        if attack.after:
            with hostile(replace(attack, kind=attack.after), server) as before:
                await before.begun()
                await asyncio.sleep(seconds)
            await asyncio.sleep(2 * WARM_S)
        before_mib = server.memory_mib()
        if tokens:
            tokens.let_in_for(LONG_S if attack.token_s is None else 2 * WARM_S + attack.token_s)
        with hostile(attack, server, tokens.hostile if tokens else "") as clients:
            await clients.begun()
            await asyncio.sleep(WARM_S)  # until the attack is fully under way
            good.forget()
            coming.forget()
            cpu_s, begun_s, most_mib = server.cpu_s(), time.perf_counter(), 0.0
            while time.perf_counter() < begun_s + seconds:
                await asyncio.sleep(0.25)
                most_mib = max(most_mib, server.memory_mib())
            share = (server.cpu_s() - cpu_s) / (time.perf_counter() - begun_s)
            noticed = good.noticed()
            coming.stop(attack.newcomer_s)
            health = await health_ms(server, attack.most_files is not None, attack.health_s)
        await asyncio.sleep(WARM_S)
        came = coming.num_served, coming.refused, coming.num_waiting
        left_mib = server.memory_mib() - before_mib
        return Suffered(noticed, came, most_mib - before_mib, left_mib, health, share, quiet_noticed)


async def run(attack: Attack, seconds: float, log: Path, quiet_s: float = 0.0) -> Result:
    """Attack a new server. quiet_s: as in `suffer`."""
    tokens = Tokens(log.parent) if attack.elsewhere or attack.token_s is not None else None
    settings = (*attack.server_settings, *(tokens.settings if tokens else ()))
    with ExitStack() as still_there, attacked(log, settings, attack.most_files, attack.module) as server:
        suffered = await suffer(attack, server, seconds, tokens, quiet_s)
        if attack.to_the_end:
            await still_there.enter_context(hostile(attack, server)).begun()
            await asyncio.sleep(WARM_S)
    said = server.log.read_text(encoding="utf-8", errors="replace")
    errors = max(said.count("error id"), said.count("Traceback"))  # gRPC's own errors have no id
    return Result(attack, suffered, server.log_mib(), server.exit_code, errors)


def row(result: Result) -> str:
    """The attack's row of the table."""
    noticed, attack, suffered = result.noticed, result.attack, result.suffered
    tier = "FULL" if noticed.lowest_tier == TIER_FULL else str(noticed.lowest_tier)
    verdict = "; ".join(result.faults) or "held"
    welcomed, refused, waiting = suffered.newcomers
    health = "none" if suffered.health_ms > 1000 * HEALTH_S else f"{suffered.health_ms:.0f} ms"
    return (
        f"| {attack.name} | {attack.clients if attack.kind else 0} | {noticed.missed:.1%} "
        f"| {noticed.edit_p95_ms:.0f} ms | {noticed.ping_p95_ms:.0f} ms | {tier} "
        f"| {welcomed} of {welcomed + refused.total() + waiting} "
        f"| {suffered.grown_mib:.0f} / {suffered.left_mib:.0f} MiB | {health} "
        f"| {suffered.gateway_cpu:.0%} | {verdict} |"
    )


def table(rows: Iterable[str]) -> str:
    """A Markdown table with a row for each attack."""
    head = (
        "| attack | clients | frames missed | edits p95 | pings p95 | tier | newcomers | memory grown / left | health "
    )
    return (
        "\n".join([head + "| gateway | verdict |", "|---|---:|---:|---:|---:|---|---:|---:|---:|---:|---|", *rows])
        + "\n"
    )


def machine() -> str:
    """The machine that was used."""
    return f"{psutil.cpu_count()} cores, load {psutil.getloadavg()[0]:.1f}"
