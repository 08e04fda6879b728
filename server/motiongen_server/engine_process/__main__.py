"""`python -m motiongen_server.engine_process FOLDER`: the engine process, which its gateway starts."""

from __future__ import annotations

import sys
from pathlib import Path

from motiongen_server.config import ServerConfig
from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine_process.engine_main import Built, run
from motiongen_server.models.loader import build_engine, load_model
from motiongen_server.ops.memory import keep_freed_memory


def build(config: ServerConfig, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
    """Load the configured model and make the engine around it."""
    model = load_model(config)
    engine = build_engine(config, model.runner, deliver, observe, inbox)
    return Built(engine, model.runner.facts, model.licence, model.threads, model.abilities)


if __name__ == "__main__":
    keep_freed_memory()
    sys.exit(run(Path(sys.argv[1]), build))
