"""Training in two processes that torchrun starts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.train import denoiser
from motiongen_ardy.train.loop import STOP_EVERY, Trainer
from motiongen_ardy.train.loop_settings import LoopSettings

ROOT = Path(__file__).resolve().parents[3]


class OneWeight:
    """A task with one weight; no step of it is trained here."""

    def __init__(self) -> None:
        self.fingerprint = ""
        self.terms: dict[str, str] = {}
        self.module = nn.Linear(1, 1)

    def kinds(self, progress: float) -> Sequence[tuple[Hashable, float]]:
        return [("one", 1.0)]

    def sample(self, kind: Hashable, generator: torch.Generator | None) -> Any:
        pytest.fail("no step is trained here")

    def export(self, averaged: nn.Module, folder: Path) -> None:
        pytest.fail("no step is trained here")


def test_all_processes_stop_at_the_same_step_if_one_has_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    others = torch.tensor(0.0)
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "all_reduce", lambda told, _: told.clamp_(min=float(others)))
    trainer = Trainer(OneWeight(), LoopSettings(tmp_path, steps=100, learning_rate=1e-3))
    trainer.step, trainer.stopping = STOP_EVERY - 1, True
    assert not trainer.stops(time.monotonic()), "the other processes would wait for its gradients"
    trainer.step = STOP_EVERY
    assert trainer.stops(time.monotonic())
    trainer.step, trainer.stopping = 2 * STOP_EVERY, False
    assert not trainer.stops(time.monotonic())
    others.fill_(1)
    assert trainer.stops(time.monotonic()), "another process has to stop"


def test_a_process_joins_before_it_puts_anything_on_its_device(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    @contextmanager
    def joined() -> Iterator[tuple[int, int]]:
        done.append("joined")
        yield 0, 1

    def load(folder: Path, device: str) -> None:
        done.append(f"put on {device}")
        raise InterruptedError

    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(denoiser, "distributed", joined)
    monkeypatch.setattr(denoiser, "load_tokenizer", load)
    monkeypatch.setattr(sys, "argv", ["denoiser", "data", "out", "--tokenizer", "run", "--device", "cuda"])
    with pytest.raises(InterruptedError):
        denoiser.main()
    assert done == ["joined", "put on cuda"], "otherwise every process would use the first device"


def test_two_processes_end_with_equal_weights_trained_on_their_averaged_gradients(tmp_path: Path) -> None:
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
    trained = load_checkpoint(tmp_path / "denoiser")
    assert trained.config.horizon == 16
    first, second = (torch.load(tmp_path / f"weights-{rank}.pt", weights_only=True) for rank in range(2))
    assert first.keys() == second.keys() == trained.denoiser.state_dict().keys()
    assert all(torch.equal(weights, second[name]) for name, weights in first.items())
    steps = [json.loads((tmp_path / f"step-{rank}.json").read_text(encoding="utf-8")) for rank in range(2)]
    assert [step["gradient"] for step in steps] == [2.0, 2.0], "the mean of 1 and 3, which the processes drew"
    assert steps[0]["weight"] == steps[1]["weight"], "though the second began with another"
