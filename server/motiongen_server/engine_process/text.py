"""EngineTextEncoder: the gateway's side of a text encoder that needs torch, and runs in the first engine process."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future

from motiongen_server.engine.types import Float32Array
from motiongen_server.engine_process.messages import Encoded, EncoderReady, EncodeTexts, LoadEncoder
from motiongen_server.engine_process.process import EngineProcess
from motiongen_server.settings import SettingError

_log = logging.getLogger(__name__)


class EncoderLost(ConnectionError):
    """The engine process cannot encode now; clients may see the message."""

    retry_after_s = 2.0


class EngineTextEncoder:
    """Satisfies `motiongen_server.text.prompts.TextEncoder`. `encode` may be called from several threads."""

    def __init__(self, process: EngineProcess, width: int, timeout_s: float) -> None:
        """Load the encoder, and wait for that. timeout_s: of one call. Raises SettingError if it cannot be loaded."""
        self.width = width
        self._process = process
        self._timeout_s = timeout_s
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._waiting: dict[int, Future[Float32Array]] = {}
        self._ready: Future[EncoderReady] = Future()
        self._missing = ""  # why the current engine process has no usable encoder
        self._loading_since: float | None = None
        process.serve_text(self._take, self._begin, self._lose)
        self.identity = self._ready.result().identity

    @property
    def loading_s(self) -> float:
        """For how many seconds its engine process has been loading it; 0 if it is not."""
        since = self._loading_since
        return 0.0 if since is None else time.monotonic() - since

    def encode(self, texts: Sequence[str]) -> Float32Array:
        """(len(texts), width). Raises EncoderLost if the engine process cannot answer now."""
        if self._process.failure is not None:
            raise EncoderLost("the text encoder has failed")
        number, answer = next(self._numbers), Future[Float32Array]()
        with self._lock:
            if self._missing:  # set after this: `_break_off` ends what waits
                raise EncoderLost(self._missing)
            self._waiting[number] = answer
        try:
            if not self._process.tell(EncodeTexts(number, tuple(texts))):
                raise EncoderLost("the text encoder has ended")
            return answer.result(self._timeout_s)
        except TimeoutError:
            raise EncoderLost(f"the text encoder takes longer than {self._timeout_s:g} s") from None
        finally:
            with self._lock:
                self._waiting.pop(number, None)

    # ---- from the thread of the engine process ----------------------------------------------------------------------

    def _begin(self) -> tuple[LoadEncoder]:
        """What to tell each new engine process."""
        self._loading_since = time.monotonic()
        return (LoadEncoder(self.width),)

    def _take(self, message: EncoderReady | Encoded) -> None:
        if isinstance(message, EncoderReady):
            self._take_ready(message)
            return
        with self._lock:
            answer = self._waiting.pop(message.number, None)
        if answer is None:
            return
        if message.error:
            answer.set_exception(EncoderLost("the text encoder failed"))
        else:
            answer.set_result(message.vectors)

    def _take_ready(self, message: EncoderReady) -> None:
        self._loading_since = None
        if not self._ready.done():
            if message.error:
                self._ready.set_exception(SettingError(message.error))
            else:
                self._ready.set_result(message)
        elif message.error:
            self._miss("the text encoder could not be loaded again", message.error)
        elif message.identity != (before := self._ready.result().identity):
            # Its vectors would be stored as the old encoder's, and mixed with them.
            now = f"the text encoder is {message.identity!r} now, and was {before!r}"
            self._miss(now, f"{now}; put the old one back, or restart the server")

    def _miss(self, told: str, logged: str) -> None:
        """The engines continue: presets, embeddings and prompts that were used before need no encoder."""
        self._missing = told
        _log.error("prompts cannot be encoded until the engine process is started anew: %s", logged)
        self._break_off(told)

    def _lose(self) -> None:
        """The engine process is gone; the next one, if any, loads the encoder again."""
        self._missing, self._loading_since = "", None
        self._break_off("the text encoder is being started anew")
        with self._lock:
            if self._ready.done():
                return
            self._ready.set_exception(SettingError("the engine process was lost while it loaded the text encoder"))

    def _break_off(self, why: str) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        for answer in waiting.values():
            answer.set_exception(EncoderLost(why))
