"""The runner: computes windows with torch and motiongen_ardy.

Rows of a batch may differ in step, step count, history, goals, guidance and seed.
"""

from motiongen_server.runner.loading import load_runner
from motiongen_server.runner.torch_runner import TorchRunner

__all__ = ["TorchRunner", "load_runner"]
