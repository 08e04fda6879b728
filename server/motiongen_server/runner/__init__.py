"""The runner: torch and ardy live here. Rows of a batch differ in step, step count, history, goals, guidance, seed."""

from motiongen_server.runner.loading import load_runner
from motiongen_server.runner.torch_runner import TorchRunner

__all__ = ["TorchRunner", "load_runner"]
