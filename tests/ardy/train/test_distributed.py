"""Training in two processes that torchrun starts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint

ROOT = Path(__file__).resolve().parents[3]


def test_two_processes_train_one_model(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node", "2"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "OMP_NUM_THREADS": "1"}
    result = subprocess.run(
        [*command, "-m", "tests.ardy.train.distributed_run", str(tmp_path)],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr[-3000:]
    assert load_checkpoint(tmp_path / "denoiser").config.horizon == 16
