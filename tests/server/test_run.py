"""The end of the process, whatever has become of what it writes to."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

LEAVING = """
import contextlib, sys
from motiongen_server.run import leave
sys.stdout.write("served")
with contextlib.suppress(OSError):
    {before}
leave(0)
"""


@pytest.mark.parametrize("before", ["pass", "sys.stdout.close()", "sys.stdout = sys.stderr = None"])
def test_an_orderly_end_is_one_also_where_nothing_can_be_written_any_more(before: str) -> None:
    with Path("/dev/full").open("wb") as full:
        ended = subprocess.run(
            [sys.executable, "-c", LEAVING.format(before=before)],
            stdout=full,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONUNBUFFERED": ""},
            check=False,
        )
    assert ended.returncode == 0, ended.stderr
