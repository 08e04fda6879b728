"""Servers behind each proxy that are killed, drained, replaced or disturbed: characters play on."""

from __future__ import annotations

import subprocess
import sys
from itertools import islice
from pathlib import Path

import pytest

from tests.scale.chaos import troubles
from tests.scale.kills import KINDS, order, read
from tests.scale.proxies import PROXIES, REPOSITORY, Proxy
from tests.scale.troubles import TROUBLES

pytestmark = pytest.mark.system


@pytest.mark.parametrize("how", ["kill", "drain"])
@pytest.mark.parametrize("kind", PROXIES)
def test_killed_or_drained_server_loses_no_event_and_no_committed_frame(kind: type[Proxy], how: str) -> None:
    """The exit code also says that every character plays on."""
    command = [
        "-m",
        "tests.scale",
        "--null",
        "--proxy",
        kind.name,
        "--how",
        how,
        "--characters",
        "12",
        "--seconds",
        "6",
    ]
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, cwd=REPOSITORY)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "committed frames that changed:        0" in done.stdout
    assert "reopened: 0 times; still away: 0" in done.stdout


def ran(*command: str) -> subprocess.CompletedProcess[str]:
    """Run a program of `tests.scale` to its end."""
    return subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, cwd=REPOSITORY)


@pytest.mark.parametrize("kind", PROXIES)
def test_replacing_servers_and_reloading_the_proxy_loses_no_frame(kind: type[Proxy]) -> None:
    done = ran("tests.scale.rolling", "--null", "--proxy", kind.name, "--characters", "8")
    assert done.returncode == 0, done.stdout + done.stderr


def test_killed_processes_cost_no_event_and_no_committed_frame(tmp_path: Path) -> None:
    """Every kind once; only the full run judges how long it takes."""
    done = ran("tests.scale.kills", "--null", "--times", "5", "--characters", "8", "--out", str(tmp_path))
    kills = read(tmp_path / "kills.jsonl")
    assert {each.what for each in kills} == set(KINDS), done.stdout + done.stderr
    for each in kills:
        assert (each.changed, each.unanswered, each.anew, each.not_back, each.ended) == (0, 0, 0, 0, ()), each
        assert bool(each.resumed) is (each.what not in ("encoder", "redis")), each


def test_random_faults_cost_no_event_and_no_committed_frame() -> None:
    done = ran("tests.scale.chaos", "--null", "--minutes", "1", "--characters", "8")
    assert done.returncode == 0, done.stdout + done.stderr


def test_same_seed_gives_the_same_faults() -> None:
    kinds = list(TROUBLES)
    drawn = [[(kind, s, draw.random()) for kind, s, draw in islice(troubles(seed, kinds), 30)] for seed in (5, 5, 6)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert {kind for kind, _, _ in drawn[0][:10]} == set(kinds)
    assert order(100, 5, ["a", "b"]) == order(100, 5, ["a", "b"]) != order(100, 6, ["a", "b"])
