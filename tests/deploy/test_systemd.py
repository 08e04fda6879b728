"""The unit of deploy/systemd."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from motiongen_server.config import ServerConfig
from tests.deploy.dashboard import REPOSITORY

UNIT = REPOSITORY / "deploy" / "systemd" / "motiongen.service"


@pytest.mark.system
def test_unit_is_valid(tmp_path: Path) -> None:
    """With a stand-in for the installed server's program."""
    assert shutil.which("systemd-analyze"), "systemd-analyze is not installed (apt-get install systemd)"
    program = tmp_path / "motiongen-server"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text(encoding="utf-8").replace("/opt/motiongen/bin/motiongen-server", str(program)))
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", str(unit)], capture_output=True, text=True)
    said = [line for line in done.stderr.splitlines() if UNIT.name in line]
    assert (done.returncode, said) == (0, []), done.stderr


def test_stop_timeout_is_longer_than_draining() -> None:
    stop_s = float(re.findall(r"^TimeoutStopSec=(\d+)$", UNIT.read_text(encoding="utf-8"), re.MULTILINE)[0])
    config = ServerConfig()
    assert stop_s > config.drain_wait_s + config.drain_grace_s + 5
