"""The processes of one training: a single one, or those that torchrun starts together."""

from __future__ import annotations

import atexit
import contextlib
import os
from collections.abc import Iterator

import torch
import torch.distributed


@contextlib.contextmanager
def distributed() -> Iterator[tuple[int, int]]:
    """(rank, number of processes); joins the process group if started by torchrun.

    One group serves all trainings of a process and is left at its end: a second group would find the first one's
    addresses in torchrun's store, and wait for them forever.
    """
    if "RANK" not in os.environ:
        yield 0, 1
        return
    if not torch.distributed.is_initialized():
        torch.distributed.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
        atexit.register(torch.distributed.destroy_process_group)
        if torch.cuda.is_available():
            torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    yield torch.distributed.get_rank(), torch.distributed.get_world_size()
