"""The contents of deploy/, checked by the tools that they are for."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.scale.proxies import PROXIES, REPOSITORY, Behind, Proxy

pytestmark = pytest.mark.system
PROMETHEUS = REPOSITORY / "deploy" / "prometheus"


def checked(*command: str) -> None:
    """Run a command. Fails with its output if it finds anything."""
    assert shutil.which(command[0]), f"{command[0]} is not installed (apt-get install prometheus haproxy nginx-light)"
    done = subprocess.run(command, capture_output=True, text=True, cwd=PROMETHEUS)
    assert done.returncode == 0, done.stdout + done.stderr


def test_prometheus_accepts_its_configuration_and_the_alert_tests_pass() -> None:
    checked("promtool", "check", "config", "scrape.yaml")
    checked("promtool", "check", "config", "--syntax-only", "compose.yaml")  # its token file does not exist here
    checked("promtool", "test", "rules", "alerts_test.yaml")


@pytest.mark.parametrize("kind", PROXIES)
def test_each_proxy_accepts_its_configuration(kind: type[Proxy], tmp_path: Path) -> None:
    proxy = kind(tmp_path, [Behind(1, 2), Behind(3, 4)])
    done = subprocess.run(proxy.check(), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
