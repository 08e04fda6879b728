"""An engine process with the fake runner, for tests: `python -m tests.server.engine_process.fake_engine HOW FOLDER`.

HOW says what goes wrong: nothing; small (an engine takes one session); settings, load (refused, or failed, while it
loads); tell_load (refused, with the admit_load that it got); schema (the greeting has another version); garbage (after
its first outputs it sends something that is not a message); stuck:FOLDER (all processes that load leave a file there,
and the second never finishes); stuck encoder:FOLDER (the same for the text encoder); large encoder; changing (each
process that loads finds other weights); shelf:FOLDER (the weights of a model are what its file there says; without a
file it cannot be loaded, and with "stuck" in it loading never ends); hang, die, fail (in the second window of a session
with the seed `FATAL_SEED`).
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.ports import Deliver, DeviceLost, Inbox, Observe
from motiongen_server.engine.types import Float32Array, RowStatus
from motiongen_server.engine_process import main as main_of_process
from motiongen_server.engine_process.host import FreeUnused, LoadText
from motiongen_server.engine_process.main import run
from motiongen_server.engine_process.messages import Begin, Outputs, ToGateway
from motiongen_server.engine_process.outlet import Wire
from motiongen_server.engine_process.slot import BuildEngine, Built
from motiongen_server.settings import SettingError
from tests.server.engine.fakes import FakeRunner, RealTime

FATAL_SEED = 666
ANY_LOAD = (1000.0, 1000.0, 1000.0, 1000.0)


class FatalRunner(FakeRunner):
    """Hangs, dies or loses its device in the second window of a session with the fatal seed."""

    how: str = ""

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        jobs = [self.jobs[job_id] for job_id in job_ids]
        if any(job.seed == FATAL_SEED and job.first_frame > 0 for job in jobs):
            if self.how == "hang":
                threading.Event().wait()
            if self.how == "die":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.how == "fail":
                raise DeviceLost("it fell off the bus")
        return super().denoise(job_ids)


def build(begin: Begin, how: str, source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
    if how == "settings" or source == "unsound":
        raise SettingError("denoise_steps is too small")
    if how == "tell_load":
        raise SettingError(f"admit_load is {begin.config.admit_load}")
    if how == "load":
        raise RuntimeError("the disk is gone")
    if how.startswith("stuck:"):
        hang_second(Path(how.partition(":")[2]))
    weights = str(os.getpid()) if how == "changing" else ""
    if how.startswith("shelf:"):
        try:
            weights = (Path(how.partition(":")[2]) / source).read_text(encoding="utf-8")
            if weights == "stuck":
                threading.Event().wait()
        except OSError as error:
            raise SettingError(f"cannot serve model {source!r}: {error}") from error
    runner = FatalRunner(RealTime())
    runner.how = how
    runner.facts = replace(runner.facts, model_id=source)
    max_sessions = 1 if how == "small" else begin.config.max_sessions
    # It plays in real time: without the other settings, sessions would be refused or degraded on a busy machine.
    engine_config = EngineConfig(max_sessions=max_sessions, admit_load=ANY_LOAD, degrade=False)
    engine = Engine(runner, RealTime(), deliver, engine_config, observe=observe, inbox=inbox)
    return Built(engine, runner.facts, "CC0-1.0", weights=weights)


def hang_second(folder: Path) -> None:
    """Hang in the second process that calls this with a folder."""
    (folder / str(os.getpid())).touch()
    if len(list(folder.iterdir())) == 2:
        threading.Event().wait()


class Stutterer:
    """Encodes a text by its length, except for one text, on which it fails."""

    identity = "length-1"

    def encode(self, texts: Sequence[str]) -> Float32Array:
        if "fail" in texts:
            raise RuntimeError("out of words")
        if "die" in texts:
            os.kill(os.getpid(), signal.SIGKILL)
        return np.array([[len(text), 0] for text in texts], np.float32)


def babble_after_outputs() -> None:
    """From now on, follow outputs by bytes that are not a message."""
    say = Wire.say

    def babbling(wire: Wire, message: ToGateway) -> None:
        say(wire, message)
        if isinstance(message, Outputs):
            wire.send(b"\xc1 no message")

    Wire.say = babbling  # type: ignore[method-assign]


def main(how: str, folder: Path) -> int:
    if how == "schema":
        main_of_process.SCHEMA = "another"  # type: ignore[attr-defined]
    if how == "garbage":
        babble_after_outputs()

    def prepare(begin: Begin) -> tuple[BuildEngine, LoadText, FreeUnused]:
        def building(source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
            return build(begin, how, source, deliver, observe, inbox)

        def load_text(width: int) -> Stutterer:
            if how == "settings":
                raise SettingError("there is no such encoder")
            if how.startswith("stuck encoder:"):
                hang_second(Path(how.partition(":")[2]))
            if how == "large encoder":
                raise MemoryError("15 GiB")
            return Stutterer()

        return building, load_text, lambda: None

    return run(folder, prepare)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
