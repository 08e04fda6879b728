"""EngineProcess: an engine process that is restarted when it is lost, and all models that it holds."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence

from motiongen_server.devices import EngineDevice
from motiongen_server.engine.ports import Deliver
from motiongen_server.engine.types import CloseReason
from motiongen_server.engine_process.absent_models import AbsentModels
from motiongen_server.engine_process.bell import Bell
from motiongen_server.engine_process.child import END_S, StartChild
from motiongen_server.engine_process.connection import Connection, EngineLost, LoadFailed, Stopped
from motiongen_server.engine_process.control import ControlQueue
from motiongen_server.engine_process.messages import (
    Begin,
    Encoded,
    EncoderReady,
    Ended,
    Outputs,
    Pulse,
    Ready,
    ToEngine,
    ToGateway,
    Unload,
    Unloaded,
)
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.engine_process.restarts import REST_S, Restarts
from motiongen_server.engine_process.silence import Silence
from motiongen_server.ops.memory import resident_bytes
from motiongen_server.settings import SettingError

_log = logging.getLogger(__name__)

HUNG_S = 30.0
"""An engine that sends nothing for this long will not recover; no single step may take as long."""
TICK_S = 0.5

TakeText = Callable[[EncoderReady | Encoded], None]


class EngineProcess:
    """One engine process after the other, on one device. Everything public may be used from any thread.

    When a process is lost, its sessions are closed as ENGINE_FAULT, and the next process loads the models that it held.
    """

    def __init__(
        self,
        name: str,
        device: EngineDevice,
        begin: Begin,
        deliver: Deliver,
        start_child: StartChild,
        *,
        hung_s: float = HUNG_S,
        rest_s: float = REST_S,
    ) -> None:
        """name: for logs and metrics. begin: its first message. start_child: starts it, given a folder of sockets."""
        self.name = name
        self.device = device
        self._first_message = begin
        self._deliver = deliver
        self._start_child = start_child
        self._hung_s = hung_s
        self._bell = Bell()
        self._control = ControlQueue()
        self.absent = AbsentModels(name, self._control, rest_s)
        self._take_text: TakeText | None = None
        self._on_loss: Callable[[], None] = lambda: None
        self._stopping = threading.Event()
        self._restarts = Restarts(rest_s)
        self._failure: BaseException | None = None
        self._connection: Connection | None = None
        self._thread = threading.Thread(target=self._run, name=f"engine-link-{name}", daemon=True)

    # ---- from any thread --------------------------------------------------------------------------------------------

    @property
    def failure(self) -> BaseException | None:
        """Why there is no engine process and none is being started; None if there is."""
        return self._failure

    @property
    def pid(self) -> int | None:
        """The engine process's pid; None while there is no process."""
        return None if (connection := self._connection) is None else connection.pid

    @property
    def num_restarts(self) -> int:
        """How often an engine process was lost."""
        return self._restarts.count

    @property
    def rss_bytes(self) -> int:
        """Memory of the engine process; 0 if unknown."""
        return 0 if (pid := self.pid) is None else resident_bytes(pid)

    @property
    def load(self) -> float:
        """The committed share of the device, for all models together."""
        return max((link.load for link in self._control), default=0.0)

    @property
    def asked(self) -> float:
        """The share of the device that the sessions of all models ask for."""
        return sum(link.asked for link in self._control)

    @property
    def num_sessions(self) -> int:
        """Sessions and clips of all models."""
        return sum(link.num_sessions for link in self._control)

    def start(self) -> None:
        """Start an engine process."""
        self._thread.start()

    def load_model(self, slot: int, source: str) -> ModelLink:
        """Begin to load a model; the link's `ready` is set when it is loaded, or to the reason why it cannot be."""
        link = ModelLink(slot, source, self._deliver, self._bell.ring)
        if self._failure is not None or not self._control.add(link):
            link.end(EngineLost(f"engine {self.name} has failed: {self._failure}"))
        self._bell.ring()
        return link

    def unload_model(self, link: ModelLink) -> None:
        """Begin to unload a model; the link's `ended` is set when it is unloaded."""
        if self._control.retire(link):
            self._bell.ring()
        else:
            link.end(EngineLost("it was unloaded before it was loaded"))

    def serve_text(
        self, take: TakeText, on_begin: Callable[[], Sequence[ToEngine]], on_loss: Callable[[], None]
    ) -> None:
        """Encode prompts too. take: gets the answers. on_begin: what to tell each new process. on_loss: at its end."""
        self._take_text, self._on_loss = take, on_loss
        if not self._control.serve_text(on_begin):
            on_loss()
        self._bell.ring()

    def tell(self, message: ToEngine) -> bool:
        """Send a message ahead of events. False if no process will receive it."""
        is_taken = self._control.tell(message)
        self._bell.ring()
        return is_taken

    def stop(self) -> None:
        """End the engine process: at once while it loads a model for the first time, else after its last message."""
        self._stopping.set()
        self._control.stop()
        if self._control.is_loading:
            self._kill()
        self._bell.ring()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end of the engine process, and kill it if it does not end in time. True if it has ended."""
        if not self._thread.ident:
            return True
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            self._kill()
            self._thread.join(END_S)
        return not self._thread.is_alive()

    # ---- the thread -------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._serve_one_after_the_other()
        except Exception as unexpected:  # without this thread no event would be answered
            _log.exception("the link to engine process %s has ended", self.name)
            self._failure = unexpected
            self._kill()
            for link in self._control.close():
                link.end(unexpected)
            self._close()

    def _serve_one_after_the_other(self) -> None:
        """Run engine processes until stopped, or until none may be started any more."""
        error: Exception | None = None
        while not self._stopping.is_set():
            try:
                self._serve(self._begin())
                break
            except Stopped:
                self._kill()
                break
            except (EngineLost, SettingError, OSError) as lost:
                error = lost
            except Exception as unexpected:
                _log.exception("the link to engine process %s failed", self.name)
                error = unexpected
            self._lose(error)
            if not self._stopping.is_set() and not self._may_start_again(error):
                break
        for link in self._control.close():
            link.end(error or EngineLost("the server is going away"))
        self._on_loss()
        self._close(END_S)

    def _begin(self) -> Connection:
        connection = Connection(self._start_child, self._bell, self._stopping.is_set, self.device.environment())
        self._connection = connection
        connection.begin(self._first_message)
        self.absent.begin()
        for link in self._control.begin():
            link.end()
        return connection

    def _serve(self, connection: Connection) -> None:
        """Send events and take outputs. Returns after Stop; raises EngineLost when the process is lost."""
        silence = Silence(self._control, 2 * TICK_S)
        while True:
            connection.wait(TICK_S, for_room=self._control.send(connection))
            self._bell.quiet()
            silence.look()
            self.absent.look(silence.missing_s)
            while (message := connection.next_message()) is not None:
                if isinstance(message, Ended):
                    if message.error:
                        raise EngineLost(message.error)
                    return
                self._take(message)
            silence.check(self._hung_s)

    def _take(self, message: ToGateway) -> None:
        if isinstance(message, EncoderReady | Encoded):
            if self._take_text is not None:
                self._take_text(message)
            return
        if not isinstance(message, Outputs | Pulse | Ready | Unloaded):
            raise EngineLost(f"the engine process said {type(message).__name__} while it served")
        if (link := self._control.get(message.slot)) is not None:
            self._take_of(link, message)
        if isinstance(message, Ready) and self._control.get(message.slot) is None:
            # The model was removed while it was being loaded again: nobody else would unload it.
            self.tell(Unload(message.slot))

    def _take_of(self, link: ModelLink, message: Outputs | Pulse | Ready | Unloaded) -> None:
        if isinstance(message, Outputs):
            link.take_outputs(message.outputs)
        elif isinstance(message, Pulse):
            link.take_pulse(message)
        elif isinstance(message, Ready):
            self._take_ready(link, message)
        elif link.ready.done() and message.error:
            self.absent.fail(link, message.error)
        elif not link.is_absent:
            self._control.remove(link)
            text = message.error or "it was unloaded"
            link.end(SettingError(text) if message.is_setting else LoadFailed(text))

    def _take_ready(self, link: ModelLink, message: Ready) -> None:
        is_again = link.ready.done()
        if not link.take_ready(message):
            self.absent.change(link)
        elif is_again:
            _log.info("engine %s serves %s again, process %s", self.name, message.facts.model_id, self.pid)
        self._failure = None

    # ---- loss -------------------------------------------------------------------------------------------------------

    def _lose(self, error: Exception) -> None:
        """Kill what may be left of the process, end its sessions, and drop models that were never loaded, or retired.

        Clients are told before anybody waits for the process to end: one that hangs in a driver does not die at once.
        """
        if not self._stopping.is_set():
            _log.error("lost engine process %s with %d sessions: %s", self.name, self.num_sessions, error)
        self._kill()
        for link in self._control.lose():
            link.end(error)
        for link in self._control:
            link.lose(CloseReason.ENGINE_FAULT, "the server's engine was lost; open a new session")
        self._deliver(())  # after its sessions, and even if it had none: says that it is gone
        self._on_loss()
        self._close()

    def _may_start_again(self, error: Exception) -> bool:
        """Wait before another process is started. False if none is to be started."""
        now = time.monotonic()
        wait_s = self._restarts.lose(now)
        if self._restarts.has_failed(now):
            self._failure = EngineLost(f"engine process {self.name} was lost again and again, lastly as {error}")
            _log.error("%s; it rests for %g s", self._failure, wait_s)
        return not self._stopping.wait(wait_s)

    def _kill(self) -> None:
        if (connection := self._connection) is not None:
            connection.kill()

    def _close(self, patience_s: float = 0.0) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close(patience_s)
