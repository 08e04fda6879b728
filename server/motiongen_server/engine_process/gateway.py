"""RemoteEngine: the engine as the gateway sees it, in a process of its own that is started anew when it is lost."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Sequence

from motiongen_server.config import ServerConfig
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.mailbox import Mailbox, refuse_pending
from motiongen_server.engine.ports import Deliver, Observe
from motiongen_server.engine.types import CloseReason, Event, Open, Outcome, Playhead
from motiongen_server.engine_process.bell import Bell
from motiongen_server.engine_process.child import END_S
from motiongen_server.engine_process.connection import Connection, EngineLost, Stopped
from motiongen_server.engine_process.ledger import Ledger, refuse_while_draining, refuse_without_engine
from motiongen_server.engine_process.messages import TO_GATEWAY, CloseAhead, Ended, Events, Outputs, Pulse, Ready, Stop
from motiongen_server.errors import SettingError

_log = logging.getLogger(__name__)

HUNG_S = 30.0
"""An engine process that says nothing for so long will not come back; a single step must not take it."""
LOSSES = 3
LOSSES_WITHIN_S = 60.0
"""So many losses within so many seconds are no accident: then the gateway fails too."""
STALE_S = 5.0
TICK_S = 0.5


class RemoteEngine:
    """The `EnginePort` of an engine in a process of its own. `load`, then `start`.

    When that process is lost, its sessions are closed as ENGINE_FAULT, and new ones are refused with a hint when to
    come again until another process has loaded the model. Waiting events are bounded as in an engine in this process.
    `deliver` and `observe` are called on one thread of this object.
    """

    def __init__(
        self,
        config: ServerConfig,
        deliver: Deliver,
        observe: Observe,
        command: Sequence[str],
        hung_s: float = HUNG_S,
    ) -> None:
        """command: starts an engine process, given a folder of sockets."""
        self._config = config
        self._deliver = deliver
        self._observe = observe
        self._command = command
        self._hung_s = hung_s
        self._max_pending = EngineConfig().max_pending_events
        self._bell = Bell()
        self._lock = threading.Lock()
        self._ledger = Ledger()
        self._mailbox = Mailbox(self._max_pending)
        self._has_events = False
        self._is_up = False
        self._is_draining = False
        self._is_stopping = False
        self._stop_is_sent = False
        self._losses: deque[float] = deque(maxlen=LOSSES - 1)
        self._heartbeat_at = time.monotonic()
        self._failure: BaseException | None = None
        self._thread: threading.Thread | None = None
        self._connection: Connection | None = None
        self._ready = b""

    # ---- from any thread --------------------------------------------------------------------------------------------

    @property
    def num_sessions(self) -> int:
        return len(self._ledger)

    @property
    def heartbeat_at(self) -> float:
        """When the loop last went round. While a new process loads: too long ago to be ready, too lately to be hung."""
        if self._is_up or self._failure is not None:
            return self._heartbeat_at
        return max(self._heartbeat_at, time.monotonic() - STALE_S)

    @property
    def failure(self) -> BaseException | None:
        return self._failure

    @property
    def pid(self) -> int | None:
        """The engine process's number, None while there is none."""
        return None if self._connection is None else self._connection.pid

    def load(self) -> Ready:
        """Start the engine process and wait until its model is loaded and warm.

        Raises SettingError for what is wrong with the settings, EngineLost if it cannot load for another reason.
        """
        self._connection, ready = self._connect()
        self._ready = TO_GATEWAY.encode(ready)
        return ready

    def start(self) -> None:
        """Begin to take events; after `load`."""
        self._is_up = True
        self._heartbeat_at = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="engine-link", daemon=True)
        self._thread.start()

    def submit(self, event: Event) -> Outcome | None:
        with self._lock:
            if self._is_draining and isinstance(event, Open):
                return refuse_while_draining(event.session, event.event_seq)
            if not self._is_up:
                if isinstance(event, Playhead):
                    return None
                return refuse_without_engine(event.session, event.event_seq)
            if not self._ledger.goes_ahead(event):
                if not self._mailbox.put(event):
                    return refuse_pending(event, self._max_pending)
                self._has_events = True
            self._ledger.note(event)
        self._bell.ring()
        return None

    def drain(self) -> None:
        self._is_draining = True

    def stop(self) -> None:
        self._is_draining = self._is_stopping = True
        self._bell.ring()
        if self._thread is None and self._connection is not None:
            self._connection.close()

    def join(self, timeout_s: float | None = None) -> bool:
        """Wait for the end of the engine process; where it does not come in time, the process is killed."""
        if self._thread is None:
            return True
        self._thread.join(timeout_s)
        if self._thread.is_alive() and self._connection is not None:
            self._connection.kill()
            self._thread.join(END_S)
        return not self._thread.is_alive()

    # ---- the thread -------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        """Serve one engine process after the other until stopped, or until they are lost too often."""
        while (connection := self._connection) is not None:
            try:
                self._serve(connection)
                self._end_sessions(CloseReason.DRAINED, "the server is going away; open a session elsewhere")
                connection.close(END_S)
                return
            except EngineLost as error:
                self._lose(connection, error)
                self._connection = self._connect_again()
            except Exception as error:
                _log.exception("the link to the engine process failed")
                self._failure = error
                self._lose(connection, error)
                return

    def _serve(self, connection: Connection) -> None:
        """Carry events there and outputs back. Returns after Stop; raises EngineLost when the process is lost."""
        silent_s, looked_at = 0.0, time.monotonic()
        while True:
            connection.wait(TICK_S, for_room=self._send(connection))
            self._bell.quiet()
            now = time.monotonic()
            # Not by the clock alone: when this process was stopped for a while, the engine process is not to blame.
            silent_s, looked_at = silent_s + min(now - looked_at, 2 * TICK_S), now
            while (message := connection.next_message()) is not None:
                silent_s = 0.0
                if isinstance(message, Outputs):
                    with self._lock:
                        outputs = self._ledger.settle(message.outputs)
                    self._deliver(outputs)
                elif isinstance(message, Pulse):
                    self._heartbeat_at = message.heartbeat_at
                    for report in message.reports:
                        self._observe(report)
                elif isinstance(message, Ended):
                    if message.error:
                        raise EngineLost(message.error)
                    return
                else:
                    raise EngineLost(f"the engine process said {type(message).__name__} while it served")
            if silent_s > self._hung_s:
                raise EngineLost(f"the engine process has said nothing for {silent_s:.1f} s")

    def _send(self, connection: Connection) -> bool:
        """Send what waits and there is room for. True if events are left."""
        with self._lock:
            first = 0
            events: list[Event] = []
            if self._has_events and connection.has_room:
                self._has_events = False
                first, events = self._ledger.number(self._mailbox.take_all())
            closes = self._ledger.take_closes()
            is_waiting = self._has_events
        if events:
            connection.send(Events(first, tuple(events)))
        for close, opened, last in closes:
            connection.send_ahead(CloseAhead(close, opened, last))
        if self._is_stopping and not self._stop_is_sent:
            self._stop_is_sent = True
            connection.send_ahead(Stop())
        return is_waiting

    # ---- loss -------------------------------------------------------------------------------------------------------

    def _lose(self, connection: Connection, error: Exception) -> None:
        """Kill what may be left of the process, and end its sessions."""
        _log.error("lost the engine process with %d sessions: %s", len(self._ledger), error)
        connection.close()
        self._end_sessions(CloseReason.ENGINE_FAULT, "the server's engine was lost; open a new session")

    def _end_sessions(self, reason: CloseReason, message: str) -> None:
        with self._lock:
            self._is_up = False
            self._mailbox = Mailbox(self._max_pending)
            self._has_events = False
            outputs = self._ledger.end_all(reason, message)
        if outputs:
            self._deliver(outputs)

    def _connect_again(self) -> Connection | None:
        """Another engine process in place of the lost one; None where there is to be none."""
        while not self._is_draining:
            now = time.monotonic()
            if len(self._losses) == self._losses.maxlen and now - self._losses[0] < LOSSES_WITHIN_S:
                self._failure = EngineLost(
                    f"the engine process was lost {LOSSES} times in {now - self._losses[0]:.0f} s"
                )
                return None
            self._losses.append(now)
            try:
                connection, ready = self._connect()
            except Stopped:
                continue
            except (EngineLost, SettingError, OSError) as error:
                _log.error("no new engine process: %s", error)
                continue
            if TO_GATEWAY.encode(ready) != self._ready:
                connection.close()
                self._failure = EngineLost("the model has changed since the server was started; start the server anew")
                return None
            with self._lock:
                self._is_up = True
                self._heartbeat_at = time.monotonic()
            _log.info("a new engine process serves, process %d", connection.pid)
            return connection
        self._failure = EngineLost("the engine process was lost while the server was draining")
        return None

    def _connect(self) -> tuple[Connection, Ready]:
        connection = Connection(self._command, self._bell, lambda: self._is_draining)
        try:
            return connection, connection.load(self._config)
        except BaseException:
            connection.close()
            raise
