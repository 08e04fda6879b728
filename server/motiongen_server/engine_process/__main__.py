"""`python -m motiongen_server.engine_process FOLDER`: the engine process, which its gateway starts."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from motiongen_server.engine_process.main import run
from motiongen_server.engine_process.model_loading import prepare
from motiongen_server.ops.memory import keep_freed_memory, use_one_arena

if __name__ == "__main__":
    keep_freed_memory()
    use_one_arena()
    # Not the interpreter's normal exit: with torch loaded it takes seconds, and a failed engine's thread may still run.
    os._exit(run(Path(sys.argv[1]), prepare))
