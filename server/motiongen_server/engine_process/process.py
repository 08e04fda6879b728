"""EngineProcess: an engine process that is started anew when it is lost, and all models that it holds."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from motiongen_server.config import ServerConfig
from motiongen_server.devices import EngineDevice
from motiongen_server.engine.ports import Deliver
from motiongen_server.engine.types import CloseReason
from motiongen_server.engine_process.bell import Bell
from motiongen_server.engine_process.child import END_S
from motiongen_server.engine_process.connection import Connection, EngineLost, Stopped
from motiongen_server.engine_process.messages import (
    Begin,
    Encoded,
    EncoderReady,
    EncodeTexts,
    Ended,
    Load,
    NotLoaded,
    Outputs,
    Pulse,
    Ready,
    Stop,
    ToEngine,
    ToGateway,
    Unload,
    Unloaded,
)
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.settings import SettingError

_log = logging.getLogger(__name__)

HUNG_S = 30.0
"""An engine that says nothing for so long will not come back; a single step must not take it."""
LOSSES = 3
LOSSES_WITHIN_S = 60.0
"""So many losses within so many seconds are no accident: then the engine counts as failed, and rests."""
REST_S = 30.0
"""Before a failed engine process is tried once more, if others have kept the server alive."""
BACK_OFF_S = 0.5
"""Before an engine process is started that was lost twice in a short time."""
TICK_S = 0.5
PAGE_BYTES = 4096

TakeText = Callable[[EncoderReady | Encoded], None]


class EngineProcess:
    """One engine process after the other, on one device. Everything public may be used from any thread.

    When one is lost, its sessions are closed as ENGINE_FAULT, and the next one loads the models that it held.
    """

    def __init__(
        self,
        name: str,
        config: ServerConfig,
        device: EngineDevice,
        deliver: Deliver,
        command: Sequence[str],
        hung_s: float = HUNG_S,
        rest_s: float = REST_S,
    ) -> None:
        """name: in logs and metrics. command: starts an engine process, given a folder of sockets."""
        self.name = name
        self.device = device
        self.num_restarts = 0
        self._config = config
        self._deliver = deliver
        self._command = command
        self._hung_s = hung_s
        self._rest_s = rest_s
        self._bell = Bell()
        self._lock = threading.Lock()
        self._links: dict[int, ModelLink] = {}
        self._unsent: deque[ToEngine] = deque()  # control messages, for the process that there is now
        self._take_text: TakeText | None = None
        self._on_begin: Callable[[], Sequence[ToEngine]] = tuple
        self._on_loss: Callable[[], None] = lambda: None
        self._stopping = threading.Event()
        self._is_draining = False
        self._losses: deque[float] = deque(maxlen=LOSSES)
        self._failure: BaseException | None = None
        self._connection: Connection | None = None
        self._thread = threading.Thread(target=self._run, name=f"engine-link-{name}", daemon=True)

    # ---- from any thread --------------------------------------------------------------------------------------------

    @property
    def failure(self) -> BaseException | None:
        """Why there is no engine process, and none is being started."""
        return self._failure

    @property
    def pid(self) -> int | None:
        """The engine process's number, None while there is none."""
        connection = self._connection
        return None if connection is None else connection.pid

    @property
    def rss_bytes(self) -> int:
        """Memory of the engine process, 0 where that is not known."""
        try:
            return PAGE_BYTES * int(Path(f"/proc/{self.pid}/statm").read_text(encoding="ascii").split()[1])
        except (OSError, IndexError, ValueError):  # it has just ended, or this system has no /proc
            return 0

    @property
    def load(self) -> float:
        """The share of the device in use, of all models."""
        return max((link.load for link in tuple(self._links.values())), default=0.0)

    @property
    def num_sessions(self) -> int:
        """Of all models."""
        return sum(link.num_sessions for link in tuple(self._links.values()))

    def start(self) -> None:
        """Start an engine process."""
        self._thread.start()

    def load_model(self, slot: int, source: str) -> ModelLink:
        """Have a model loaded; the link's `ready` tells when that is done, or why it cannot be."""
        link = ModelLink(slot, source, self._deliver, self._bell.ring)
        with self._lock:
            if self._failure is not None or self._stopping.is_set():
                link.end(EngineLost(f"engine {self.name} has failed: {self._failure}"))
                return link
            self._links[slot] = link
            self._unsent.append(Load(slot, source))
        self._bell.ring()
        return link

    def unload_model(self, link: ModelLink) -> None:
        """Have a model forgotten; the link's `ended` tells when that is done."""
        with self._lock:
            link.is_retired = True
            if link.is_up:
                self._unsent.append(Unload(link.slot))
                self._bell.ring()
                return
            self._links.pop(link.slot, None)
        link.end(EngineLost("it was unloaded before it was loaded"))

    def serve_text(
        self, take: TakeText, on_begin: Callable[[], Sequence[ToEngine]], on_loss: Callable[[], None]
    ) -> None:
        """Encode prompts too. on_begin: what each new process is told; take: what it answers; on_loss: it is gone."""
        with self._lock:
            self._take_text, self._on_begin, self._on_loss = take, on_begin, on_loss
            self._unsent += on_begin()
        self._bell.ring()

    def tell(self, message: ToEngine) -> None:
        """Send a message ahead of events."""
        with self._lock:
            self._unsent.append(message)
        self._bell.ring()

    def drain(self) -> None:
        """Start no more engine processes."""
        self._is_draining = True

    def stop(self) -> None:
        """End the engine process: at once while it loads its first model, else after its last words."""
        self._is_draining = True
        self._stopping.set()
        with self._lock:
            self._unsent.append(Stop())
            connection = self._connection
            is_loading = any(not link.ready.done() for link in self._links.values())
        if connection is not None and is_loading:
            connection.kill()
        self._bell.ring()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end of the engine process; where it does not come in time, it is killed."""
        if not self._thread.ident:
            return True
        self._thread.join(timeout_s)
        if self._thread.is_alive() and self._connection is not None:
            self._connection.kill()
            self._thread.join(END_S)
        return not self._thread.is_alive()

    # ---- the thread -------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        """Serve one engine process after the other until stopped."""
        error: Exception | None = None
        while not self._stopping.is_set():
            try:
                self._begin()
                self._serve()
                break
            except Stopped:
                self._close()
                break
            except (EngineLost, SettingError, OSError) as lost:
                error = lost
            except Exception as unexpected:
                _log.exception("the link to engine process %s failed", self.name)
                error = unexpected
            self._lose(error)
            if not self._stopping.is_set() and not self._may_start_again(error):
                break
        self._close(END_S)
        for link in self._forget_all():
            link.end(error or EngineLost("the server is going away"))

    def _begin(self) -> None:
        connection = Connection(self._command, self._bell, self._stopping.is_set, self.device.environment())
        self._connection = connection
        connection.begin(Begin(self._config, self.device.kind, self.device.threads))
        with self._lock:
            texts = [message for message in self._unsent if isinstance(message, EncodeTexts)]
            self._unsent.clear()
            self._unsent += [Load(link.slot, link.source) for link in self._links.values()]
            self._unsent += [*self._on_begin(), *texts]
            if self._stopping.is_set():
                self._unsent.append(Stop())

    def _serve(self) -> None:
        """Carry events there and outputs back. Returns after Stop; raises EngineLost when the process is lost."""
        connection, looked_at = self._connection, time.monotonic()
        if connection is None:
            raise EngineLost("there is no engine process")
        while True:
            connection.wait(TICK_S, for_room=self._send(connection))
            self._bell.quiet()
            now = time.monotonic()
            # Not by the clock alone: when this process was stopped for a while, the engine process is not to blame.
            passed_s, looked_at = min(now - looked_at, 2 * TICK_S), now
            links = tuple(self._links.values())
            for link in links:
                link.silent_s = link.silent_s + passed_s if link.is_up else 0.0
            while (message := connection.next_message()) is not None:
                if isinstance(message, Ended):
                    if message.error:
                        raise EngineLost(message.error)
                    return
                self._take(message)
            silent_s = max((link.silent_s for link in links), default=0.0)
            if silent_s > self._hung_s:
                raise EngineLost(f"an engine of the process has said nothing for {silent_s:.1f} s")

    def _take(self, message: ToGateway) -> None:
        if isinstance(message, EncoderReady | Encoded):
            if self._take_text is not None:
                self._take_text(message)
            return
        if not isinstance(message, Outputs | Pulse | Ready | NotLoaded | Unloaded):
            raise EngineLost(f"the engine process said {type(message).__name__} while it served")
        link = self._links.get(message.slot)
        if link is None:
            return
        if isinstance(message, Outputs):
            link.take_outputs(message.outputs)
        elif isinstance(message, Pulse):
            link.take_pulse(message)
        elif isinstance(message, Ready):
            self._take_ready(link, message)
        elif link.ready.done() and isinstance(message, NotLoaded):
            raise EngineLost(f"{link.source!r} cannot be loaded again: {message.error}")
        else:
            with self._lock:
                self._links.pop(link.slot, None)
            is_setting = isinstance(message, NotLoaded) and message.is_setting
            text = message.error if isinstance(message, NotLoaded) else "it was unloaded"
            link.end(SettingError(text) if is_setting else EngineLost(text))

    def _take_ready(self, link: ModelLink, message: Ready) -> None:
        is_again = link.ready.done()
        if not link.take_ready(message):
            raise EngineLost("the model has changed since the server was started; start the server anew")
        if is_again:
            self._failure = None
            _log.info("engine %s serves %s again, process %s", self.name, message.facts.model_id, self.pid)

    def _send(self, connection: Connection) -> bool:
        """Send what waits and there is room for. True if events are left."""
        with self._lock:
            control = tuple(self._unsent)
            self._unsent.clear()
        is_waiting = False
        for link in tuple(self._links.values()):
            if link.has_events and connection.has_room and (events := link.take_events()) is not None:
                connection.send(events)
            is_waiting |= link.has_events
            for close in link.take_closes():
                connection.send_ahead(close)
        for message in control:
            connection.send_ahead(message)
        return is_waiting

    # ---- loss -------------------------------------------------------------------------------------------------------

    def _lose(self, error: Exception) -> None:
        """Kill what may be left of the process, end its sessions, and let go of what it never held, or no more."""
        if not self._stopping.is_set():
            _log.error("lost engine process %s with %d sessions: %s", self.name, self.num_sessions, error)
        self._close()
        with self._lock:
            self._unsent.clear()
            gone = [link for link in self._links.values() if link.is_retired or not link.ready.done()]
            for link in gone:
                del self._links[link.slot]
        for link in gone:
            link.end(error)
        for link in tuple(self._links.values()):
            link.lose(CloseReason.ENGINE_FAULT, "the server's engine was lost; open a new session")
        self._on_loss()

    def _may_start_again(self, error: Exception) -> bool:
        """Wait for as long as is wise before another process is started. False where there is to be none."""
        if self._is_draining:
            self._failure = EngineLost("the engine process was lost while the server was draining")
            return False
        now = time.monotonic()
        self._losses.append(now)
        self.num_restarts += 1
        recent = sum(now - at < LOSSES_WITHIN_S for at in self._losses)
        if recent >= LOSSES:
            what = f"engine process {self.name} was lost {recent} times in {LOSSES_WITHIN_S:.0f} s"
            self._failure = EngineLost(f"{what}, lastly as {error}")
            _log.error("%s; it rests for %g s", self._failure, self._rest_s)
            self._stopping.wait(self._rest_s)
        elif recent > 1:
            self._stopping.wait(BACK_OFF_S)
        return not self._is_draining

    def _forget_all(self) -> list[ModelLink]:
        with self._lock:
            links = list(self._links.values())
            self._links.clear()
        return links

    def _close(self, patience_s: float = 0.0) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close(patience_s)
