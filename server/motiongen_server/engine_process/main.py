"""Runs an engine process, from its greeting to its end."""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import zmq

from motiongen_server.engine_process import signals
from motiongen_server.engine_process.codec import CodecError
from motiongen_server.engine_process.host import EngineHost, FreeUnused, LoadText, ended_by
from motiongen_server.engine_process.messages import GREETING, SCHEMA, TO_ENGINE, Begin, Greeting, Joined
from motiongen_server.engine_process.outlet import Wire
from motiongen_server.engine_process.slot import BuildEngine
from motiongen_server.engine_process.sockets import EngineEnd
from motiongen_server.ops.logs import configure_logs
from motiongen_server.ops.memory import settled_objects

_log = logging.getLogger(__name__)

GATEWAY_GONE = 3
"""The exit code of an engine process that has lost its gateway."""

Prepare = Callable[[Begin], tuple[BuildEngine, LoadText, FreeUnused]]
"""Returns what loads models and a text encoder in an engine process, and what frees memory that they keep."""


def run(folder: Path, prepare: Prepare) -> int:
    """Serve the gateway that listens in the folder. Returns the exit code: 0 after Stop, 1 for a failure."""
    signals.ignore()
    threading.Thread(target=_end_with_gateway, name="lifeline", daemon=True).start()
    end = EngineEnd(folder)
    end.back.send(GREETING.encode(Greeting(SCHEMA, time.monotonic())))
    wire = Wire(end.back)
    failure: BaseException | None
    try:
        begin = _begun(end.events)
        _begun(end.ahead)
        configure_logs(begin.config.log_level, begin.config.log_format)
        wire.say(Joined())
        with settled_objects():
            failure = EngineHost(end, wire, *prepare(begin)).run()
    except Exception as error:
        _log.exception("the engine process failed")
        failure = error
    wire.say(ended_by(failure))
    wire.finish()
    end.close()
    return 0 if failure is None else 1


def _begun(socket: zmq.Socket[bytes]) -> Begin:
    message = TO_ENGINE.decode(socket.recv())
    if not isinstance(message, Begin):
        raise CodecError(f"the first message was {type(message).__name__}, not Begin")
    return message


def _end_with_gateway() -> None:
    """Only the gateway holds standard input open, so it ends when the gateway does, for whatever reason."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os._exit(GATEWAY_GONE)
