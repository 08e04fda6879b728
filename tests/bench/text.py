"""What it costs to turn a prompt into a vector: `python -m tests.bench.text`. Starts its own encoder service."""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from motiongen_ardy.text import HashedTextEncoder, load_text_encoder
from motiongen_ardy.text.store import VectorStore
from motiongen_server.text.encoder.client import RemoteEncoder
from motiongen_server.text.ports import TextEncoder
from motiongen_server.text.prompts import PromptEncoder
from tests.server.text.encoder.encoder_process import EncoderProcess

WIDTH = 4096
ROUNDS = 400
AN_EDIT = 16
"""Prompts in one edit: the most that a session can have."""


def measure(what: str, act: Callable[[int], object]) -> None:
    """Print the median and the 99th percentile of one call, in microseconds. act: is called with a number."""
    times = []
    for number in range(ROUNDS):
        started = time.perf_counter()
        act(number)
        times.append(1e6 * (time.perf_counter() - started))
    print(f"{what:56} {np.median(times):8.0f} {np.percentile(times, 99):8.0f}")


def main() -> int:
    argparse.ArgumentParser(prog="python -m tests.bench.text", description=__doc__).parse_args()
    print(f"{f'{ROUNDS} prompts, one after another, of {WIDTH} numbers':56} {'p50 µs':>8} {'p99 µs':>8}")
    static, hashed = load_text_encoder("static"), HashedTextEncoder(WIDTH)
    measure("static (256 numbers), in the process", lambda number: static.encode([f"a person walks {number} steps"]))
    vector = hashed.encode(["a person walks"])[0]
    with tempfile.TemporaryDirectory() as folder:
        store = VectorStore(Path(folder) / "prompts.db", hashed.identity, WIDTH)
        measure("kept on the disk", lambda number: store.put(f"prompt {number}", vector))
        measure("found on the disk", lambda number: store.get(f"prompt {number}"))
        store.close()
        log = Path(folder) / "log.txt"
        with EncoderProcess(log, "--text-encoder", "hashed", "--width", str(WIDTH)) as process:
            remote = RemoteEncoder(process.address)
            measure("hashed, encoder service, new", lambda number: remote.encode([f"{number}"]))
            measure("the same, known to the service", lambda number: remote.encode([f"{number}"]))
            remote.close()
    prompts = PromptEncoder(hashed, ROUNDS)
    prompts.remember("a person walks", vector)
    measure("known to the server", lambda _: prompts.cached("a person walks"))
    asyncio.run(asyncio.to_thread(prompts.close))
    asyncio.run(measure_edits(static))
    return 0


async def measure_edits(encoder: TextEncoder) -> None:
    """Print what new prompts of one edit cost this process, requested one by one and together, in microseconds."""
    prompts = PromptEncoder(encoder, AN_EDIT)
    for what, together in (("each alone", 1), ("together", AN_EDIT)):
        started = time.process_time()
        for first in range(0, ROUNDS, together):
            texts = [f"a person walks {first + number} steps, {what}" for number in range(together)]
            await prompts.encode_all(texts)
        each_us = 1e6 * (time.process_time() - started) / ROUNDS
        print(f"{f'static, a new prompt of {AN_EDIT} in an edit, {what}, processor time':72} {each_us:8.0f}")
    prompts.close()


if __name__ == "__main__":
    sys.exit(main())
