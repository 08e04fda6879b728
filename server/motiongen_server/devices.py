"""The devices of the engine processes, as `--devices` or the machine says, and how much they admit by default."""

from __future__ import annotations

import logging
import math
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from motiongen_server.processor_quota import quota_cores, quota_use
from motiongen_server.settings import SettingError

_log = logging.getLogger(__name__)

MOST_BY_DEFAULT = 8
"""Engines that are started on a CPU if the setting does not say how many; each holds every model."""
MOST_ENGINES = 64
MOST_THREADS = 256
FORMS = (
    "cuda:0,cuda:1 (these), cuda:0x3 (three engines on it), cuda:all, cuda:allx3, "
    "cpu:2 (two engines of a thread each), cpu:2x4 (two of four threads)"
)
ADMIT_LOAD = 0.87
ADMIT_LOAD_QUOTA = 0.9
ADMIT_LOAD_SCANT = 0.86
ADMIT_LOAD_SHARED = 0.75
ADMIT_LOAD_THROTTLED = 0.65
"""Defaults of `--admit-load`, in this order: without a quota, where the use of the gateway is not counted; under a
quota, all use of which is counted; under a quota of less than one core for each thread, where engines are throttled;
with more threads than cores, or several engines on a GPU; and under too small a quota whose use is not reported. With
more than these, sessions were degraded (docs/performance/admission.md, gpu.md).
"""
KERNELS_KEPT = {"ONEDNN_PRIMITIVE_CACHE_CAPACITY": "192", "LRU_CACHE_CAPACITY": "64"}
"""Sizes of two caches in an engine process: compiled matrix products of oneDNN, of 0.6 MiB each, and descriptions of
them that torch keeps in each thread, of 0.3 MiB each once the product is gone. An operator's own values take
precedence. A product is made again in 0.3 ms, a description in 0.02 ms. Both caches are full after some minutes, and
memory does not grow from then on.
"""
CUDA_VISIBLE = "CUDA_VISIBLE_DEVICES"
_CPU = re.compile(r"cpu:(\d{1,4})(?:x(\d{1,4}))?")
_CUDA = re.compile(r"cuda:(\d{1,3}|all)(?:x(\d{1,4}))?")
_PROBE = "import torch; print(torch.cuda.device_count() if torch.cuda.is_available() else 0)"
_PROBE_S = 120.0


@dataclass(frozen=True, slots=True)
class EngineDevice:
    """Where one engine process computes. kind: cpu or cuda. index: of the CUDA device. threads: on the CPU."""

    kind: str
    index: int
    threads: int

    def environment(self) -> dict[str, str]:
        """Environment variables that its process needs before it loads any library."""
        kept = {name: os.environ.get(name, value) for name, value in KERNELS_KEPT.items()}
        kept["OMP_NUM_THREADS"] = str(self.threads)
        if self.kind != "cuda":
            return kept
        # A process sees only its own device: it can neither fill the memory of another nor fail with it.
        return {**kept, CUDA_VISIBLE: self.cuda_name()}

    def cuda_name(self) -> str:
        """The driver's name for a CUDA device. Raises SettingError if this process's environment hides the device."""
        visible = _visible_cuda()
        if visible is None:
            return str(self.index)
        if self.index >= len(visible):
            raise SettingError(
                f"devices has {self}, counted from 0 among the {len(visible)} that {CUDA_VISIBLE} shows, which is "
                f"{os.environ[CUDA_VISIBLE]!r}"
            )
        return visible[self.index]

    def __str__(self) -> str:
        return f"cuda:{self.index}" if self.kind == "cuda" else f"cpu x {self.threads}"


def check_devices(given: str) -> None:
    """Raise SettingError for a value that is invalid on every machine."""
    _parsed(given, lambda: 1)


def devices_of(given: str, count_cuda: Callable[[], int] | None = None) -> tuple[EngineDevice, ...]:
    """The device of each engine process that the setting asks for.

    given: if empty, all CUDA devices, or without any of them one engine with one thread for each core, up to
    `MOST_BY_DEFAULT`. count_cuda: returns the number of CUDA devices; it may take seconds. Raises SettingError.
    """
    count = count_cuda or count_cuda_devices
    if not given:
        cuda = count()
        given = "cuda:all" if cuda else f"cpu:{min(usable_cores(), MOST_BY_DEFAULT)}"
        devices = _parsed(given, lambda: cuda)
    else:
        devices = _parsed(given, count)
    for device in devices:
        if device.kind == "cuda":
            device.cuda_name()  # raises now, instead of in an engine process that cannot start
    return devices


def _visible_cuda() -> tuple[str, ...] | None:
    """The CUDA devices that the environment shows to this process, by the driver's names; None if all of them.

    The variable is read as CUDA reads it: devices after an invalid one are hidden, and if it is empty, all are.
    """
    said = os.environ.get(CUDA_VISIBLE)
    if said is None:
        return None
    return tuple(takewhile(lambda name: name and not name.startswith("-"), (name.strip() for name in said.split(","))))


def _parsed(given: str, count_cuda: Callable[[], int]) -> tuple[EngineDevice, ...]:
    devices: list[EngineDevice] = []
    named: list[int] = []
    for part in given.split(",") if given else ():
        cpu, cuda = _CPU.fullmatch(part.strip()), _CUDA.fullmatch(part.strip())
        if cpu is not None:
            engines, threads = int(cpu[1]), int(cpu[2] or 1)
            if not 1 <= engines <= MOST_ENGINES or not 1 <= threads <= MOST_THREADS:
                raise SettingError(
                    f"devices has {part.strip()!r}; there may be 1 to {MOST_ENGINES} engines of 1 to "
                    f"{MOST_THREADS} threads"
                )
            devices += [EngineDevice("cpu", 0, threads)] * engines
        elif cuda is not None:
            engines = int(cuda[2] or 1)
            if not 1 <= engines <= MOST_ENGINES:
                raise SettingError(f"devices has {part.strip()!r}; a device may have 1 to {MOST_ENGINES} engines")
            indices = range(count_cuda()) if cuda[1] == "all" else [int(cuda[1])]
            if not indices:
                raise SettingError(f"devices has {part.strip()!r}, but torch finds no CUDA device here; use cpu:1")
            named += indices
            devices += [EngineDevice("cuda", index, 1) for index in indices for _ in range(engines)]
        else:
            raise SettingError(f"devices is {given!r}; it must be one of {FORMS}, or several of these with commas")
    repeated = next((index for index, times in Counter(named).items() if times > 1), None)
    if repeated is not None:
        raise SettingError(
            f"devices is {given!r}; give each CUDA device once: cuda:{repeated}x2 has two engines on one"
        )
    if len(devices) > MOST_ENGINES:
        raise SettingError(f"devices is {given!r}, {len(devices)} engines; there may be {MOST_ENGINES}")
    return tuple(devices)


def admit_load_for(devices: Sequence[EngineDevice]) -> float:
    """The default of `--admit-load`: the share of the measured capacity up to which sessions are admitted.

    Engines that share cores or a GPU wait for each other, and longer than their margin if they are nearly full. Under a
    quota all processes wait, including the gateway; engines count its use if that is reported (`quota_use`).
    """
    if any(count > 1 for device, count in Counter(devices).items() if device.kind == "cuda"):
        return ADMIT_LOAD_SHARED
    threads = sum(device.threads for device in engines_at_work(devices) if device.kind == "cpu")
    quota = quota_cores()
    if threads >= quota and quota_use() is None:
        return ADMIT_LOAD_THROTTLED if threads > quota else ADMIT_LOAD_SHARED
    if threads > usable_cores():
        return ADMIT_LOAD_SHARED
    if threads > quota:
        return ADMIT_LOAD_SCANT
    return ADMIT_LOAD_QUOTA if threads == quota else ADMIT_LOAD


def spare_engines(devices: Sequence[EngineDevice]) -> tuple[bool, ...]:
    """Which engines, in order, are spare: no core is left for their threads, so they only replace lost engines.

    Engines that share a core wait for each other, and make smaller steps than one of them alone would. On a quota of
    one core, one engine serves half as many characters again as two (docs/performance/admission.md).
    """
    cores, spare = usable_cores(), []
    for device in devices:
        is_cpu = device.kind == "cpu"
        spare.append(is_cpu and cores <= 0)
        cores -= device.threads if is_cpu else 0
    return tuple(spare)


def engines_at_work(devices: Sequence[EngineDevice]) -> tuple[EngineDevice, ...]:
    """The engines that are not spare, in order."""
    return tuple(device for device, spare in zip(devices, spare_engines(devices), strict=True) if not spare)


def usable_cores() -> int:
    """Cores that this process may use, by its affinity and by the quota of its control group."""
    cores, quota = len(os.sched_getaffinity(0)), quota_cores()
    return cores if quota == math.inf else max(1, min(cores, math.ceil(quota)))


def count_cuda_devices() -> int:
    """How many CUDA devices torch can use. A separate process asks torch: this one never loads it."""
    if not any(Path("/dev").glob("nvidia[0-9]*")) and not Path("/dev/dxg").exists():
        return 0
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=_PROBE_S, check=True
        )
        return int(done.stdout)
    except subprocess.CalledProcessError as error:
        said = (error.stderr or "").strip().rpartition("\n")[2]
        why = f"it ended with exit code {error.returncode}: {said[:200]}"
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        why = str(error)
    _log.warning("whether torch can use the CUDA devices of this machine is not known, so none is used: %s", why)
    return 0
