"""Two servers behind each proxy, and one of them goes: characters play on as they were."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.scale.proxies import PROXIES, REPOSITORY, Proxy

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
