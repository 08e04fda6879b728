"""The three ZeroMQ sockets between gateway and engine process, on paths that only this user can reach.

`events` carries what may wait, `ahead` what may not (closes, loading, stop), `back` everything that the engine process
sends. The queues of `events` and `back` are bounded: when they are full, the sender keeps its messages.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path

import zmq

from motiongen_server.settings import SettingError

EVENT_MESSAGES = 32
"""Most messages that wait on `events`, on each side."""
BACK_MESSAGES = 64
"""Most messages that wait on `back`, on each side; one message has all that the engine delivers in one call."""
LAST_WORDS_MS = 2000
"""How long an engine process that ends waits until the gateway has taken its messages."""


class GatewayEnd:
    """Listens in a new folder that no other user can enter. Used by one thread."""

    def __init__(self) -> None:
        """Raises SettingError if the folder for temporary files cannot hold sockets."""
        try:
            self.folder = Path(tempfile.mkdtemp(prefix="motiongen-"))
        except OSError as error:
            raise SettingError(f"no folder for the engine's sockets can be made; set TMPDIR: {error}") from error
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        try:
            self.events = self._listen("events", zmq.PUSH, EVENT_MESSAGES)
            self.ahead = self._listen("ahead", zmq.PUSH, 0)
            self.back = self._listen("back", zmq.PULL, BACK_MESSAGES)
        except zmq.ZMQError as error:
            self.close()
            raise SettingError(
                f"no socket can be made in {self.folder}; set TMPDIR to a shorter path: {error}"
            ) from error

    def _listen(self, way: str, kind: int, most: int) -> zmq.Socket[bytes]:
        socket = self._context.socket(kind)
        socket.setsockopt(zmq.LINGER, 0)
        socket.set_hwm(most)
        socket.bind(f"ipc://{self.folder / way}")
        return socket

    def seal(self) -> None:
        """Remove the paths: nobody else can connect, and nothing is left behind, however the process ends."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def close(self) -> None:
        """Drop what has not been sent."""
        self._context.destroy(linger=0)
        self.seal()


class EngineEnd:
    """Connects to the gateway's folder. Used by one thread."""

    def __init__(self, folder: Path) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.events = self._connect(folder, "events", zmq.PULL, EVENT_MESSAGES)
        self.ahead = self._connect(folder, "ahead", zmq.PULL, 0)
        self.back = self._connect(folder, "back", zmq.PUSH, BACK_MESSAGES)

    def _connect(self, folder: Path, way: str, kind: int, most: int) -> zmq.Socket[bytes]:
        socket = self._context.socket(kind)
        socket.set_hwm(most)
        socket.connect(f"ipc://{folder / way}")
        return socket

    def close(self) -> None:
        """Wait up to `LAST_WORDS_MS` until the gateway has taken all messages, and close."""
        self._context.destroy(linger=LAST_WORDS_MS)


def poller_of(reads: Iterable[zmq.Socket[bytes] | int], writes: zmq.Socket[bytes] | None = None) -> zmq.Poller:
    """A poller for whether any of `reads` can be read, or `writes` can be written."""
    poller = zmq.Poller()
    for each in reads:
        poller.register(each, zmq.POLLIN)
    if writes is not None:
        poller.register(writes, zmq.POLLOUT)
    return poller
