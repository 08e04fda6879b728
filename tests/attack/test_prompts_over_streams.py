"""Two addresses that fill the text encoder's queue, from many streams each, leave room for other clients."""

from __future__ import annotations

import asyncio
from pathlib import Path

import httpx

from motiongen_client import MotionClient
from tests.attack.attack import Attack, hostile
from tests.attack.server import SLOW_ENCODER, Attacked, attacked
from tests.waiting import LIMIT_S, until_true

EDITS = 8
SETTINGS = ("--prompt-timeout-s", "600", "--peer-calls-per-second", "5000")


def refused(server: Attacked) -> float:
    """The number of prompts so far that were refused because the queue was full."""
    metrics = httpx.get(f"http://127.0.0.1:{server.ops_port}/metrics").text
    lines = [line for line in metrics.splitlines() if line.startswith("motiongen_prompts_total")]
    return sum(float(line.split()[-1]) for line in lines if "TEXT_ENCODER_BUSY" in line)


async def test_edits_of_other_clients_are_answered_while_the_encoder_queue_is_full(tmp_path: Path) -> None:
    attack = Attack("prompts", "prompts_over_streams", 2)
    with attacked(tmp_path / "log", SETTINGS, module=SLOW_ENCODER) as server, hostile(attack, server):
        async with asyncio.timeout(LIMIT_S), MotionClient(server.address) as client:
            session = await client.open("a person walks")
            await until_true(lambda: refused(server) > 0)
            before = refused(server)
            for number in range(EDITS):
                await session.set_prompt(f"a person waves {number}")  # raises an error if it is refused
            await until_true(lambda: refused(server) > before)  # the attack is still going on
    assert server.exit_code == 0
