"""What a snapshot of a session costs each process: `python -m tests.bench.snapshot_cost [--records N] [--store URL]`.

A record of the size that the built-in model's sessions have goes all the way: the engine process encodes it; the
gateway decodes it, serializes it, checks it and gives it to the store, in one transaction with all that wait in a
second. Only CPU time counts, including the kernel's, so the figures are valid on a machine that is also used by others.
The share of a core is for characters that are each saved so many times a second.
"""

from __future__ import annotations

import argparse
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from motiongen_server.engine.types import SnapshotTaken
from motiongen_server.engine_process.messages import TO_GATEWAY, Outputs
from motiongen_server.snapshots.record import SessionRecord, write_record
from motiongen_server.snapshots.store import Lease
from motiongen_server.snapshots.stores import open_snapshot_store
from tests.server.snapshots.records import a_record

ROW_WIDTH = 118
"""Of the built-in model: 27 joints with one quaternion each, the root, contacts."""
FRAMES = 76
"""Frames that a session holds: a history, a horizon, and what its client may not have shown yet."""
BATCH = 64


def full_size() -> SessionRecord:
    """A record of the built-in model's size, including a prompt of the encoder's width."""
    record = a_record()
    random = np.random.default_rng(1)
    rows = random.normal(size=(FRAMES, ROW_WIDTH)).astype(np.float32)
    prompts = tuple(
        replace(each, embedding=random.normal(size=256).astype(np.float32)) for each in record.snapshot.prompts
    )
    return replace(record, snapshot=replace(record.snapshot, rows=rows, prompts=prompts))


def cost_us(work: Callable[[], object], times: int) -> float:
    """CPU time of one call, microseconds, after a call that warms caches."""
    work()
    begun = time.process_time_ns()
    for _ in range(times):
        work()
    return (time.process_time_ns() - begun) / 1000 / times


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.snapshot_cost", description=__doc__)
    parser.add_argument("--records", type=int, default=2000, help="default: %(default)s")
    parser.add_argument("--store", default="", help="like --snapshot-store (default: a new SQLite file)")
    parser.add_argument("--characters", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--a-second", type=float, default=1.5, help="snapshots of each (default: %(default)s)")
    options = parser.parse_args()
    record = full_size()
    message = Outputs(0, (SnapshotTaken(record.snapshot.spec.session, record.snapshot),))
    sent, data = TO_GATEWAY.encode(message), write_record(record)
    batches = max(1, options.records // BATCH)
    with tempfile.TemporaryDirectory(prefix="snapshot-cost-") as folder:
        store = open_snapshot_store(options.store or "auto", 600.0, Path(folder))
        assert store is not None
        leases = [Lease(f"{number:064x}", 1) for number in range(BATCH)]
        steps = {
            "engine process: encoded": cost_us(lambda: TO_GATEWAY.encode(message), options.records),
            "gateway: decoded": cost_us(lambda: TO_GATEWAY.decode(sent), options.records),
            "gateway: written down": cost_us(lambda: write_record(record), options.records),
            f"gateway: to the store, {BATCH} at once": cost_us(
                lambda: store.save([(lease, data) for lease in leases]), batches
            ) / BATCH,
            "gateway: to the store, one at once": cost_us(lambda: store.save([(leases[0], data)]), batches),
        }  # fmt: skip
        store.drop(leases)
        store.close()
    about = f"{platform.machine()}, Python {platform.python_version()}, {options.records} of each"
    print(f"a record: {len(data)} bytes; {about}")
    rate = options.characters * options.a_second
    print(f"| step | us a record | {options.characters} characters, {options.a_second:g} a second each: of a core |")
    print("|---|---:|---:|")
    for name, us in steps.items():
        print(f"| {name} | {us:.0f} | {us * rate / 1e6:.1%} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
