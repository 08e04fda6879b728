"""What tests receive from an engine in another process, and send to it."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from motiongen_server.config import ServerConfig
from motiongen_server.devices import EngineDevice
from motiongen_server.engine.ports import Observe
from motiongen_server.engine.types import (
    Chunk,
    Close,
    Closed,
    Guidance,
    Open,
    Outcome,
    Output,
    Playhead,
    Priority,
    SessionKey,
    SessionSpec,
    SetPlayState,
    StartPose,
)
from motiongen_server.engine.types import PlayState as State
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.group import EngineGroup
from motiongen_server.engine_process.pool import EnginePool
from tests.waiting import LIMIT_S, until

KEY = SessionKey(1, 1)


class Audience:
    """Keeps all outputs and reports; tests can wait until there are enough."""

    def __init__(self) -> None:
        self.outputs: list[Output] = []
        self.reports: list[StepReport] = []
        self._heard = threading.Condition()

    def deliver(self, outputs: Sequence[Output]) -> None:
        with self._heard:
            self.outputs += outputs
            self._heard.notify_all()

    def observe(self, report: StepReport) -> None:
        with self._heard:
            self.reports.append(report)
            self._heard.notify_all()

    def observer_of(self, model_id: str, engine: str) -> Observe:
        """`observe`, for the reports of any engine."""
        return self.observe

    def wait_for(self, enough: Callable[[Audience], object]) -> None:
        """Wait until `enough` is true. Raises AssertionError if that does not happen."""
        with self._heard:
            assert self._heard.wait_for(lambda: bool(enough(self)), LIMIT_S), self.outputs

    def of(self, kind: type, key: SessionKey = KEY) -> list[Output]:
        """All outputs of a kind for a session so far."""
        with self._heard:
            return [output for output in self.outputs if type(output) is kind and output.session == key]

    def wait_for_frames(self, num_frames: int, key: SessionKey = KEY) -> None:
        self.wait_for(lambda heard: sum(len(c.rows) for c in heard.of(Chunk, key)) >= num_frames)  # type: ignore[attr-defined]

    def wait_for_end(self, key: SessionKey = KEY) -> Closed:
        self.wait_for(lambda heard: heard.of(Closed, key))
        closed = self.of(Closed, key)[-1]
        assert isinstance(closed, Closed)
        return closed

    def answers(self, key: SessionKey = KEY) -> list[tuple[int, str]]:
        """(event_seq, code) of each outcome, in order."""
        return [(o.event_seq, o.code.name) for o in self.of(Outcome, key) if isinstance(o, Outcome)]


def command(how: str) -> list[str]:
    return [sys.executable, "-m", "tests.server.engine_process.fake_engine", how]


@dataclass(frozen=True)
class Remote:
    """A model on engine processes with the fake runner."""

    pool: EnginePool
    engine: EngineGroup
    audience: Audience

    def pid(self, number: int = 0) -> int | None:
        """The process id of an engine process."""
        return self.pool.processes[number].pid

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """All engine processes are stopped in this context."""
        with ExitStack() as standing:
            for process in self.pool.processes:
                assert process.pid is not None
                standing.enter_context(stopped(process.pid))
            yield


@contextmanager
def pool_of(
    how: str = "nothing",
    engines: int = 1,
    hung_s: float = LIMIT_S,
    rest_s: float = LIMIT_S,
    *,
    threads: int = 1,
    **settings: object,
) -> Iterator[tuple[EnginePool, Audience]]:
    """Engine processes with the fake runner and that many threads each, ended when the test is over."""
    audience = Audience()
    config = ServerConfig(**settings)  # type: ignore[arg-type]
    devices = [EngineDevice("cpu", 0, threads)] * engines
    told = audience.deliver, audience.observer_of
    pool = EnginePool(config, devices, *told, command(how), hung_s=hung_s, rest_s=rest_s)
    try:
        yield pool, audience
    finally:
        pool.stop()
        assert pool.join(LIMIT_S)


@contextmanager
def remote(
    how: str = "nothing", engines: int = 1, hung_s: float = LIMIT_S, rest_s: float = LIMIT_S, **settings: object
) -> Iterator[Remote]:
    """Engine processes as of `pool_of` with a model loaded, which is unloaded at the end."""
    with pool_of(how, engines, hung_s, rest_s, **settings) as (pool, audience):
        engine = pool.load("fake")
        yield Remote(pool, engine, audience)
        engine.stop()
        assert engine.join(LIMIT_S)


def opening(key: SessionKey = KEY, seed: int = 1) -> Open:
    spec = SessionSpec(key, seed, "fake", Priority.HERO, 40, 4, Guidance(1.0, 1.0), StartPose())
    return Open(spec, 1, time.monotonic())


def playhead(frame: int, key: SessionKey = KEY) -> Playhead:
    return Playhead(key, 0, time.monotonic(), frame, frame + 10, 0)


def play(seq: int, key: SessionKey = KEY) -> SetPlayState:
    return SetPlayState(key, seq, time.monotonic(), State.PLAYING)


def close(seq: int, key: SessionKey = KEY) -> Close:
    return Close(key, seq, time.monotonic())


def _state(stat: Path) -> str:
    """The kernel's letter for the state of a process or thread."""
    return stat.read_text(encoding="ascii").rpartition(")")[2].split()[0]


def is_gone(pid: int) -> bool:
    """Whether a process has ended; a zombie counts as ended."""
    try:
        return _state(Path(f"/proc/{pid}/stat")) == "Z"
    except FileNotFoundError:
        return True


def stop(pid: int) -> None:
    """Sends SIGSTOP, and waits until every thread has stopped."""
    os.kill(pid, signal.SIGSTOP)
    until(lambda: all(_state(stat) == "T" for stat in Path(f"/proc/{pid}/task").glob("*/stat")))


@contextmanager
def stopped(pid: int) -> Iterator[None]:
    """A process is stopped in this context."""
    stop(pid)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)
