"""Which kernels oneDNN makes while windows are served, and that it keeps no more of them than allowed."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from motiongen_server.devices import KERNELS_KEPT

# Batches of all sizes, histories of all lengths, and waypoints at all distances, mixed.
SERVING = """
import random
import numpy as np
import torch
from motiongen_server.engine.types import (
    Guidance, PlanCause, Priority, SessionKey, StartPose, Waypoint, WindowJob,
)
from motiongen_server.runner.loading import load_runner

torch.set_num_threads(1)
runner = load_runner("motiongen-mini", precision="float32")
facts, draw = runner.facts, random.Random(5)
known, number = np.zeros((0, facts.feature_dim), np.float32), 0


def job():
    global number
    number += 1
    history = known[: facts.patch * draw.choice((0, 1, 2, 4))]
    first = len(history)
    points = (Waypoint(1, first + draw.choice((10, 39, 47, 61)), 0.0, 1.0),) if draw.random() < 0.5 else ()
    return WindowJob(
        job_id=number, session=SessionKey(0, number), plan=1, first_frame=first, history=history,
        start_pose=None if first else StartPose(), embedding=np.full(facts.embedding_dim, 0.1, np.float32),
        constraints=points, seed=number, num_steps=2, guidance=Guidance(1.0, 1.0), deadline=0.0,
        priority=Priority.NEAR, cause=PlanCause.CONTINUE, created_at=0.0,
    )


def serve(size):
    jobs = [job() for _ in range(size)]
    ids = [one.job_id for one in jobs]
    runner.prepare(jobs)
    for _ in range(2):
        runner.denoise(ids)
    return runner.decode(ids)


known = serve(1)[0].features
print("loaded", flush=True)
for sizes in (range(1, 17), range(16, 0, -1)):
    for size in sizes:
        serve(size)
"""


# Layers of many widths, with every size that products are padded to, twice: bytes in use after each half.
KEEPING = """
import ctypes
import torch
from torch import nn
from motiongen_ardy.model.packed.linear import PackedLinear, filled_size

torch.set_num_threads(1)
FIELDS = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"


class Used(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in FIELDS.split()]


mallinfo = ctypes.CDLL(None).mallinfo2
mallinfo.restype = Used
sizes = sorted({filled_size(count) for count in range(1, 257)})
for widths in (range(8, 40), range(40, 72)):
    with torch.inference_mode():
        for width in widths:
            layer = PackedLinear.of(nn.Linear(width, 16), torch.float32)
            for size in sizes:
                layer(torch.ones(size, width))
    used = mallinfo()
    print(used.uordblks + used.hblkhd, len(widths) * len(sizes))
"""
KEPT_MIB = 8.0

# The same product before and after all have been freed.
FREEING = """
import torch
from torch import nn
from motiongen_ardy.model.packed.linear import PackedLinear
from motiongen_server.runner.kernels import free_kernels

layer = PackedLinear.of(nn.Linear(24, 16), torch.float32)
with torch.inference_mode():
    layer(torch.ones(8, 24))
print("loaded", flush=True)
with torch.inference_mode():
    layer(torch.ones(8, 24))
print("again", flush=True)
free_kernels()
print("freed", flush=True)
with torch.inference_mode():
    layer(torch.ones(8, 24))
"""


def printed_by(program: str, **more: str) -> str:
    """What a program prints in an engine's environment. more: further environment variables."""
    environment = {**os.environ, **KERNELS_KEPT, "OMP_NUM_THREADS": "1", **more}
    command = [sys.executable, "-c", program]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


def made_while_serving() -> tuple[list[tuple[str, ...]], int]:
    """What each kernel made while serving is for, as oneDNN reports it, kind first; and how often one was reused.

    In an engine's environment.
    """
    _, served = printed_by(SERVING, ONEDNN_VERBOSE="profile_create").split("loaded\n")
    lines = [line.split(",") for line in served.splitlines() if "create:cache_miss" in line]
    made = [tuple(fields[fields.index("create:cache_miss") + 2 : -1]) for fields in lines]
    return made, served.count("create:cache_hit")


def test_serving_makes_only_products_and_rarely_the_same_again() -> None:
    made, found = made_while_serving()
    assert {kernel[0] for kernel in made} <= {"inner_product"}, "other kinds have a kernel for each shape of a batch"
    again = len(made) - len(set(made))
    assert again <= 0.02 * found, "too few kernels are kept for these windows"


def test_memory_of_kept_products_is_bounded() -> None:
    """Memory in use according to malloc, once more products were made than are kept, and after as many again."""
    first, then = ([int(number) for number in line.split()] for line in printed_by(KEEPING).splitlines())
    assert first[1] > int(KERNELS_KEPT["ONEDNN_PRIMITIVE_CACHE_CAPACITY"])
    assert then[0] - first[0] < KEPT_MIB * (1 << 20)


@pytest.mark.parametrize("places", [KERNELS_KEPT["ONEDNN_PRIMITIVE_CACHE_CAPACITY"], ""])
def test_free_kernels_frees_kept_products(places: str) -> None:
    """oneDNN reports that a product made before is reused, and made again after all have been freed.

    Torch's own cache is limited to one entry here; otherwise it would be used in place of oneDNN's.
    """
    more = {"ONEDNN_VERBOSE": "profile_create", "ONEDNN_PRIMITIVE_CACHE_CAPACITY": places, "LRU_CACHE_CAPACITY": "1"}
    again, freed = printed_by(FREEING, **more).split("loaded\n")[1].split("again\n")
    anew = freed.split("freed\n")[1]
    assert "create:cache_hit,cpu,inner_product" in again
    assert "create:cache_miss,cpu,inner_product" in anew
