"""An engine process that computes nothing: `python -m tests.bench.null_engine FOLDER`, started by the null server."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine_process.host import FreeUnused, LoadText, TextEncoder
from motiongen_server.engine_process.main import run
from motiongen_server.engine_process.messages import Begin
from motiongen_server.engine_process.model_loading import build_engine
from motiongen_server.engine_process.slot import BuildEngine, Built
from motiongen_server.ops.memory import keep_freed_memory
from tests.bench.null_runner import STEP_S, NullEncoder, NullRunner


def prepare(begin: Begin) -> tuple[BuildEngine, LoadText, FreeUnused]:
    def build(source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        runner = NullRunner(STEP_S)
        return Built(build_engine(begin.config, runner, deliver, observe, inbox), runner.facts, "none")

    def load_text(width: int) -> TextEncoder:
        return NullEncoder()

    return build, load_text, lambda: None


if __name__ == "__main__":
    keep_freed_memory()
    os._exit(run(Path(sys.argv[1]), prepare))
