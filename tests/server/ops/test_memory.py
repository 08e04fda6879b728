"""Keeping freed memory for reuse, giving it back to the operating system, and garbage collection."""

from __future__ import annotations

import gc
import itertools
import os
import platform
import resource
import subprocess
import sys
import weakref

import pytest

from motiongen_server.ops.memory import (
    COLLECT_EVERY,
    FIRST_LOOKS,
    KEPT_BYTES,
    MOST_LOOKS,
    FreedMemory,
    free_garbage,
    give_back_freed_memory,
    keep_freed_memory,
    resident_bytes,
    settled_objects,
    use_one_arena,
)

LARGE = 4 << 20
IS_GLIBC = platform.libc_ver()[0] == "glibc"
needs_glibc = pytest.mark.skipif(not IS_GLIBC, reason="only glibc has mallopt and malloc_trim")
SCRIPT = f"""
import resource
from motiongen_server.ops.memory import keep_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

kept = keep_freed_memory()
bytes({LARGE}).count(1)
before = faults()
for _ in range(20):
    (b"x" * {LARGE}).count(1)
print(int(kept), faults() - before)
"""


@needs_glibc
def test_freed_large_blocks_are_reused_without_new_page_faults() -> None:
    ran = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    kept, faults = map(int, ran.stdout.split())
    assert kept
    assert faults < 2 * LARGE / resource.getpagesize()


GIVEN_BACK = f"""
from pathlib import Path
from motiongen_server.ops.memory import keep_freed_memory, settle_again

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * {resource.getpagesize()}

kept = keep_freed_memory()
blocks = [b"x" * {LARGE} for _ in range(8)]
last = b"y" * {LARGE}
del blocks
before = resident()
settle_again()
print(int(kept), before - resident())
"""


@needs_glibc
def test_memory_freed_after_loading_is_given_back() -> None:
    ran = subprocess.run([sys.executable, "-c", GIVEN_BACK], capture_output=True, text=True, check=True)
    kept, given_back = map(int, ran.stdout.split())
    assert kept
    assert given_back > 6 * LARGE


PEAK_OF_A_THREAD = f"""
import os
import threading
from motiongen_server.ops.memory import give_back_freed_memory, keep_freed_memory, resident_bytes, use_one_arena

def work():
    blocks = [b"x" * {LARGE} for _ in range(8)]

is_one = keep_freed_memory() and use_one_arena()
before = resident_bytes(os.getpid())
thread = threading.Thread(target=work)
thread.start()
thread.join()
give_back_freed_memory()
print(int(is_one), resident_bytes(os.getpid()) - before)
"""


@needs_glibc
def test_memory_of_a_threads_peak_is_given_back() -> None:
    ran = subprocess.run([sys.executable, "-c", PEAK_OF_A_THREAD], capture_output=True, text=True, check=True)
    is_one, stays = map(int, ran.stdout.split())
    assert is_one
    assert stays < LARGE


def test_without_mallopt_and_malloc_trim_nothing_is_kept_or_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ctypes.CDLL", lambda name: object())
    assert not keep_freed_memory()
    assert not use_one_arena()
    assert not give_back_freed_memory()


def test_objects_are_frozen_and_collected_rarely_only_while_settled() -> None:
    before = gc.get_threshold()
    with settled_objects():
        assert gc.get_freeze_count() > 1000
        assert gc.get_threshold() == COLLECT_EVERY
    assert (gc.get_freeze_count(), gc.get_threshold()) == (0, before)


class Ring:
    """Refers to itself, so that only garbage collection frees it."""

    def __init__(self) -> None:
        self.itself = self


def test_garbage_among_settled_objects_is_freed_on_demand() -> None:
    with settled_objects():
        held = weakref.ref(Ring())
        assert held() is not None
        free_garbage()
        assert held() is None


def test_resident_memory_is_reported_and_is_0_for_an_ended_process() -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    assert resident_bytes(os.getpid()) > 1 << 20
    assert resident_bytes(ended.pid) == 0


def test_memory_is_given_back_once_for_each_peak() -> None:
    resident = 100 << 20
    freed = FreedMemory(lambda: resident)
    assert not freed.is_due(is_busy=True)
    resident += KEPT_BYTES // 2
    assert not freed.is_due(is_busy=True), "usual growth is kept"
    resident += KEPT_BYTES
    assert freed.is_due(is_busy=True)
    assert not freed.is_due(is_busy=True), "it did not help; only a higher peak calls for another try at once"
    resident = 90 << 20
    assert not freed.is_due(is_busy=True)
    resident += KEPT_BYTES + 1
    assert freed.is_due(is_busy=True)


def test_giving_back_after_a_lasting_peak_is_retried_ever_more_rarely() -> None:
    resident = 100 << 20
    freed = FreedMemory(lambda: resident)
    assert not freed.is_due(is_busy=False)
    resident += KEPT_BYTES + 1
    tries = [look for look in range(1000) if freed.is_due(is_busy=False)]
    gaps = [FIRST_LOOKS * 2**number for number in range((MOST_LOOKS // FIRST_LOOKS).bit_length())]
    assert tries == [0, *itertools.accumulate(gaps)]
    assert gaps[-1] == MOST_LOOKS
    resident += KEPT_BYTES + 1
    assert freed.is_due(is_busy=False), "a higher peak"
    assert [look for look in range(1, 1000) if freed.is_due(is_busy=False)] == tries[1:]


def test_memory_is_given_back_once_whenever_work_ends() -> None:
    freed = FreedMemory(lambda: 100 << 20)
    assert [freed.is_due(is_busy=busy) for busy in (False, True, True, False, False, True, False)] == [
        False, False, False, True, False, False, True
    ]  # fmt: skip
