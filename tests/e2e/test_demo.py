"""`motiongen demo` as a newcomer runs it: the built-in model, a server of its own, files at the end."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from motiongen_ardy.data.bvh import read_bvh


def test_the_demo_shows_eight_characters_and_leaves_nothing_running(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "motiongen_tools", "demo", "--seconds", "6", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    clips = [read_bvh(path) for path in sorted(tmp_path.glob("*.bvh"))]
    assert len(clips) == 8
    assert all(clip.num_frames >= 108 for clip in clips)
    assert all(np.isfinite(clip.values).all() for clip in clips)
    assert (tmp_path / "contact_sheet.png").stat().st_size > 50_000
    assert "server stopped by SIGTERM, exit code 0" in done.stdout
