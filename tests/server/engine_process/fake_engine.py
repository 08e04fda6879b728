"""An engine process with the fake runner, for tests: `python -m tests.server.engine_process.fake_engine HOW FOLDER`.

HOW says what is to go wrong: nothing; settings, load (refused, or failing, while it loads); schema (the greeting is of
another version); garbage (after its first outputs it says what is no message); hang, die (in the second window of a
session with the seed `FATAL_SEED`).
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from motiongen_server.config import ServerConfig
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine.types import Output, RowStatus
from motiongen_server.engine_process import engine_main
from motiongen_server.engine_process.engine_main import Built, run
from motiongen_server.errors import SettingError
from tests.server.engine.fakes import FakeRunner

FATAL_SEED = 666


class RealTime:
    """The clock of a process that plays in real time; what takes virtual time takes none."""

    def now(self) -> float:
        return time.monotonic()

    def advance(self, seconds: float) -> None:
        pass


class FatalRunner(FakeRunner):
    """Hangs or dies in the second window of a session with the fatal seed."""

    how: str = ""

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        jobs = [self.jobs[job_id] for job_id in job_ids]
        if any(job.seed == FATAL_SEED and job.first_frame > 0 for job in jobs):
            if self.how == "hang":
                while True:
                    time.sleep(60)
            if self.how == "die":
                os.kill(os.getpid(), signal.SIGKILL)
        return super().denoise(job_ids)


def build(how: str, config: ServerConfig, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
    if how == "settings":
        raise SettingError("denoise_steps is too small")
    if how == "load":
        raise RuntimeError("the disk is gone")
    runner = FatalRunner(RealTime())  # type: ignore[arg-type]
    runner.how = how
    engine_config = EngineConfig(max_sessions=config.max_sessions)
    engine = Engine(runner, RealTime(), deliver, engine_config, observe, inbox)
    return Built(engine, runner.facts, "CC0-1.0", threads=3)


def main(how: str, folder: Path) -> int:
    if how == "schema":
        engine_main.SCHEMA = "another"  # type: ignore[attr-defined]

    def building(config: ServerConfig, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        def babble(outputs: Sequence[Output]) -> None:
            deliver(outputs)
            inbox._outlet._unsent.append(b"\xc1 no message")  # type: ignore[attr-defined]
            inbox._outlet.flush()  # type: ignore[attr-defined]

        return build(how, config, babble if how == "garbage" else deliver, observe, inbox)

    return run(folder, building)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
