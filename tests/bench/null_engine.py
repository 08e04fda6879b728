"""An engine process that computes nothing: `python -m tests.bench.null_engine FOLDER`, which the null server starts."""

from __future__ import annotations

import sys
from pathlib import Path

from motiongen_server.config import ServerConfig
from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine_process.engine_main import Built, run
from motiongen_server.models.loader import build_engine
from motiongen_server.ops.memory import keep_freed_memory
from tests.bench.null_runner import STEP_S, NullRunner


def build(config: ServerConfig, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
    runner = NullRunner(STEP_S)
    return Built(build_engine(config, runner, deliver, observe, inbox), runner.facts, "none", threads=1)


if __name__ == "__main__":
    keep_freed_memory()
    sys.exit(run(Path(sys.argv[1]), build))
