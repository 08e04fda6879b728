"""The gateway's connection to an engine process that has died or cannot be ended: it never waits for ever."""

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
"""After this time, a send that would wait for ever fails, so that the test ends."""
# Sends its greeting, and ends without connecting the other two sockets.
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


def test_sending_to_a_dead_engine_does_not_block_and_its_death_is_reported() -> None:
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


def test_engine_that_accepts_no_message_counts_as_lost() -> None:
    with connected(*command("nothing")) as connection:
        connection.begin(BEGIN)
        os.kill(connection.pid, signal.SIGKILL)
        until(lambda: not connection._end.ahead.poll(0, zmq.POLLOUT))
        connection.send_ahead(Unload(1))
        with pytest.raises(EngineLost, match="takes no messages"):
            connection.next_message()


def test_engine_that_ends_between_greeting_and_connecting_counts_as_lost() -> None:
    with (
        connected(sys.executable, "-c", GREETS_AND_ENDS) as connection,
        pytest.raises(EngineLost, match="exit code 0 before it was ready"),
    ):
        connection.begin(BEGIN)


class Stubborn(FreshChild):
    """A child whose end takes until the test allows it."""

    may_end: threading.Event

    def end(self, patience_s: float) -> str:
        self.may_end.wait()
        return super().end(patience_s)


def test_sessions_of_a_lost_engine_are_closed_before_its_process_has_ended() -> None:
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


def test_process_that_cannot_be_killed_is_left_and_reaped_when_it_ends(
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


def test_forked_process_that_cannot_be_killed_is_left_to_its_fork_server(
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
