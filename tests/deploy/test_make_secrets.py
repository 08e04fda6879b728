"""The secrets of a deployment are all made or none, so that they can be made again."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT

OPENSSL = """#!/bin/sh
while [ $# -gt 0 ]; do case $1 in -keyout | -out) : > "$2" ;; esac; shift; done
echo 00ff
"""
IDENTITY = """#!/bin/sh
if [ "$1" != --help ]; then kill -{signal} $PPID; fi
"""


def program(path: Path, text: str) -> Path:
    path.write_text(text)
    path.chmod(0o755)
    return path


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interruption_leaves_no_half_of_them(number: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "programs").mkdir()
    program(tmp_path / "programs" / "openssl", OPENSSL)
    identity = program(tmp_path / "identity", IDENTITY.format(signal=number.name.removeprefix("SIG")))
    path = f"{tmp_path / 'programs'}:{os.environ['PATH']}"
    made = subprocess.run(
        ["sh", str(ROOT / "deploy" / "make_secrets.sh"), str(tmp_path / "its secrets")],
        env={**os.environ, "PATH": path, "IDENTITY": str(identity)},
        check=False,
    )
    assert made.returncode == 128 + number
    assert not (tmp_path / "its secrets").exists()
