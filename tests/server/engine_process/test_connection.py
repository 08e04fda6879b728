"""What the gateway does when an engine process is gone, or does not go: it waits for nobody without an end."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
import zmq

from motiongen_server.config import ServerConfig
from motiongen_server.devices import EngineDevice
from motiongen_server.engine.types import CloseReason
from motiongen_server.engine_process import child as child_module
from motiongen_server.engine_process import forking
from motiongen_server.engine_process.bell import Bell
from motiongen_server.engine_process.child import FreshChild
from motiongen_server.engine_process.connection import Connection, EngineLost
from motiongen_server.engine_process.messages import Begin, Events, Unload
from motiongen_server.engine_process.process import EngineProcess
from tests.server.engine_process.audience import LIMIT_S, Audience, command, is_gone, opening
from tests.server.engine_process.test_forking import FORK_SERVER
from tests.waiting import until

BEGIN = Begin(ServerConfig(), "cpu", 1, 1)
SOON_MS = 1000
"""After which who would wait for ever is told that nobody is there, so that the test ends."""
# Greets on the way back, and ends without the other two.
GREETS_AND_ENDS = """
import sys, time, zmq
from motiongen_server.engine_process.messages import GREETING, SCHEMA, Greeting
context = zmq.Context()
back = context.socket(zmq.PUSH)
back.connect(f"ipc://{sys.argv[1]}/back")
back.send(GREETING.encode(Greeting(SCHEMA, time.monotonic())))
context.destroy(linger=2000)
"""


@contextmanager
def connected(*program: str) -> Iterator[Connection]:
    connection = Connection(partial(FreshChild, program), Bell(), lambda: False)
    for socket in (connection._end.events, connection._end.ahead):
        socket.setsockopt(zmq.SNDTIMEO, SOON_MS)
    try:
        yield connection
    finally:
        connection.close()


def test_what_is_to_go_to_an_engine_that_has_died_keeps_nobody_and_its_death_is_told() -> None:
    with connected(*command("nothing")) as connection:
        connection.begin(BEGIN)
        os.kill(connection.pid, signal.SIGKILL)
        until(lambda: not connection._end.ahead.poll(0, zmq.POLLOUT))
        until(lambda: not connection._end.events.poll(0, zmq.POLLOUT))
        connection.send_ahead(Unload(1))
        connection.send(Events(1, 1, ()))
        connection.wait(LIMIT_S, for_room=False)
        with pytest.raises(EngineLost, match="killed by SIGKILL"):
            connection.next_message()


def test_an_engine_that_takes_nothing_is_lost_before_its_death_is_seen() -> None:
    with connected(*command("nothing")) as connection:
        connection.begin(BEGIN)
        os.kill(connection.pid, signal.SIGKILL)
        until(lambda: not connection._end.ahead.poll(0, zmq.POLLOUT))
        connection.send_ahead(Unload(1))
        with pytest.raises(EngineLost, match="takes no messages"):
            connection.next_message()


def test_who_greets_and_never_connects_is_not_waited_for_beyond_its_death() -> None:
    with (
        connected(sys.executable, "-c", GREETS_AND_ENDS) as connection,
        pytest.raises(EngineLost, match="exit code 0 before it was ready"),
    ):
        connection.begin(BEGIN)


class Stubborn(FreshChild):
    """Its end is not to be had until a test says so."""

    may_end: threading.Event

    def end(self, patience_s: float) -> str:
        self.may_end.wait()
        return super().end(patience_s)


def test_sessions_hear_of_a_loss_before_the_end_of_a_process_that_does_not_end() -> None:
    audience, may_end = Audience(), threading.Event()

    def start(folder: Path, environment: Mapping[str, str]) -> Stubborn:
        child = Stubborn(command("garbage"), folder, environment)
        child.may_end = may_end
        return child

    process = EngineProcess("0", EngineDevice("cpu", 0, 1), BEGIN, audience.deliver, start)
    process.start()
    try:
        link = process.load_model(1, "fake")
        link.ready.result(LIMIT_S)
        assert link.submit(opening()) is None
        assert audience.wait_for_end().reason is CloseReason.ENGINE_FAULT
        assert not link.is_up
    finally:
        may_end.set()
        process.stop()
        assert process.join(LIMIT_S)


def test_a_process_that_cannot_be_killed_is_left_behind_and_reaped_when_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child_module, "KILL_S", 0.0)
    child = FreshChild((sys.executable, "-c", "import signal; signal.pause()"), tmp_path, {})
    monkeypatch.setattr(child, "kill", lambda: None)
    assert child.end(0.0) == f"was killed, but is still there: process {child.pid}"
    assert not is_gone(child.pid)
    child.close()
    os.kill(child.pid, signal.SIGKILL)
    until(lambda: not Path(f"/proc/{child.pid}").exists())


def test_one_that_was_forked_and_cannot_be_killed_is_left_to_its_fork_server(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forking, "KILL_S", 0.0)
    link = forking.ForkServerLink(FORK_SERVER)
    child = link.start(tmp_path, {})
    with monkeypatch.context() as patched:
        patched.setattr(child, "kill", lambda: None)
        assert child.end(0.0) == f"was killed, but is still there: process {child.pid}"
    assert not is_gone(child.pid)
    os.kill(child.pid, signal.SIGKILL)
    child.close()
    until(lambda: not Path(f"/proc/{child.pid}").exists())
    link.stop()
    link.join(child_module.END_S)
