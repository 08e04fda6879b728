"""Layers with fused kernels between their matrix products: their results, and where they are not used."""

from __future__ import annotations

import logging
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from motiongen_ardy.model.packed import fused
from motiongen_ardy.model.packed.fused import fused_stack
from tests.ardy.model import fused_layers
from tests.ardy.model.fused_layers import stack_of

ROOT = Path(__file__).parents[3]
LIMIT_S = 600


def test_interpreted_kernels_give_the_results_of_torch() -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", fused_layers.__file__]
    environment = {**os.environ, "TRITON_INTERPRET": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout
    assert re.search(r"^6 passed", done.stdout, re.MULTILINE), done.stdout


def test_on_a_cpu_the_kernels_are_not_used() -> None:
    assert fused_stack(stack_of(False).layers) is None


def test_a_machine_without_a_compiler_falls_back_with_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "motiongen_ardy.model.packed.kernels", None)
    with caplog.at_level(logging.WARNING):
        assert fused._compiled.__wrapped__(torch.device("cpu")) is None
    assert "which takes longer" in caplog.text
