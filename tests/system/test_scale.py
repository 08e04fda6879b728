"""Servers behind each proxy that go, are replaced, or are in trouble: characters play on as they were."""

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
def test_no_event_is_lost_and_no_committed_frame_changes_behind(kind: type[Proxy], how: str) -> None:
    """The program's exit code says so, and that every character plays on."""
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
    assert "opened anew: 0 times; not back: 0" in done.stdout


def ran(*command: str) -> subprocess.CompletedProcess[str]:
    """A program of `tests.scale`, to its end."""
    return subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, cwd=REPOSITORY)


@pytest.mark.parametrize("kind", PROXIES)
def test_servers_are_replaced_and_the_proxy_is_reloaded_without_a_lost_frame_behind(kind: type[Proxy]) -> None:
    done = ran("tests.scale.rolling", "--null", "--proxy", kind.name, "--characters", "8")
    assert done.returncode == 0, done.stdout + done.stderr


def test_processes_that_are_killed_cost_nobody_an_event_or_a_committed_frame(tmp_path: Path) -> None:
    """Every kind once; how long it took is for the full run to judge."""
    done = ran("tests.scale.kills", "--null", "--times", "5", "--characters", "8", "--out", str(tmp_path))
    kills = read(tmp_path / "kills.jsonl")
    assert {each.what for each in kills} == set(KINDS), done.stdout + done.stderr
    for each in kills:
        assert (each.changed, each.unanswered, each.anew, each.not_back, each.ended) == (0, 0, 0, 0, ()), each
        assert bool(each.resumed) is (each.what not in ("encoder", "redis")), each


def test_troubles_cost_nobody_an_event_or_a_committed_frame() -> None:
    done = ran("tests.scale.chaos", "--null", "--minutes", "1", "--characters", "8")
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_same_seed_gives_the_same_troubles() -> None:
    kinds = list(TROUBLES)
    drawn = [[(kind, s, draw.random()) for kind, s, draw in islice(troubles(seed, kinds), 30)] for seed in (5, 5, 6)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert {kind for kind, _, _ in drawn[0][:10]} == set(kinds)
    assert order(100, 5, ["a", "b"]) == order(100, 5, ["a", "b"]) != order(100, 6, ["a", "b"])
