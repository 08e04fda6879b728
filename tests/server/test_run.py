"""The end of the server's process when its standard output cannot be written."""

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
def test_process_exits_with_code_0_when_its_output_cannot_be_written(before: str) -> None:
    with Path("/dev/full").open("wb") as full:
        ended = subprocess.run(
            [sys.executable, "-c", LEAVING.format(before=before)],
            stdout=full,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONUNBUFFERED": ""},
            check=False,
        )
    assert ended.returncode == 0, ended.stderr
