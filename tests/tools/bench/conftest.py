"""A scenario of two seconds, and the real server with a runner that computes nothing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.server_process import ready

ROOT = Path(__file__).resolve().parents[3]
SHORT = """
format: 1
name: short
revision: 1
description: A second of everything but the stick.
characters: 6
characters_per_stream: 4
ramp_s: 0.2
settle_s: 0
tail_s: 0.5
groups:
  - name: near
    share: 0.5
    priority: NEAR
    prompts: [walk, run away]
    edits:
      - {kind: prompt, every_s: 0.4}
  - name: passing
    share: 0.5
    priority: CROWD
    life: {median_s: 1, sigma: 0.5}
    prompts: [walk]
    edits:
      - {kind: constraints, every_s: 0.5, timing: random, waypoints: 3}
"""


@pytest.fixture
def short_scenario(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def null_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The server's address. At the end, it must end with exit code 0."""
    log = tmp_path_factory.mktemp("null_server") / "stderr.txt"
    settings = ["--port", "0", "--ops-port", "0", "--drain-wait-s", "0", "--devices", "cpu:1"]
    with log.open("w", encoding="utf-8") as errors:
        command = [sys.executable, "-m", "tests.bench.null_server", *settings]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True)
    with ready(process, log) as told:
        yield f"localhost:{told['grpc_port']}"
    assert process.returncode == 0, log.read_text()
