"""`motiongen demo` with its defaults: it starts a server with the built-in model, and writes files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from motiongen_ardy.data.bvh import read_bvh
from tests.waiting import LIMIT_S


def test_demo_writes_eight_characters_and_leaves_nothing_running(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "motiongen_tools",
        "demo",
        "--seconds",
        "6",
        "--out",
        str(tmp_path),
    ]  # no waypoint is due by then
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * LIMIT_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    clips = [read_bvh(path) for path in sorted(tmp_path.glob("*.bvh"))]
    assert len(clips) == 8
    assert all(clip.num_frames == 120 for clip in clips)
    assert all(np.isfinite(clip.values).all() for clip in clips)
    for sheet in ("contact_sheet.png", "contact_sheet_beside.png"):
        assert (tmp_path / sheet).stat().st_size > 40_000
    assert "960 frames" in done.stdout
    assert "server stopped by SIGTERM, exit code 0" in done.stdout
