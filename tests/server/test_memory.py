"""Memory that is kept: a block that was freed is there again without the operating system."""

from __future__ import annotations

import resource
import subprocess
import sys

LARGE = 4 << 20
SCRIPT = f"""
import resource
from server.memory import keep_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

kept = keep_freed_memory()
bytes({LARGE}).count(1)
before = faults()
for _ in range(20):
    (b"x" * {LARGE}).count(1)
print(int(kept), faults() - before)
"""


def test_large_blocks_are_not_faulted_in_again_and_again() -> None:
    ran = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    kept, faults = map(int, ran.stdout.split())
    assert not kept or faults < 2 * LARGE / resource.getpagesize()
