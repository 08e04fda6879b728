"""The engine process, from its greeting to its end. Its main thread is the engine's."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import zmq

from motiongen_server.config import ServerConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine.types import ModelFacts
from motiongen_server.engine_process.codec import CodecError
from motiongen_server.engine_process.inlet import Inlet
from motiongen_server.engine_process.messages import GREETING, SCHEMA, TO_ENGINE, Begin, Ended, Greeting, Joined, Ready
from motiongen_server.engine_process.outlet import Outlet
from motiongen_server.engine_process.sockets import EngineEnd
from motiongen_server.errors import SettingError
from motiongen_server.ops.logs import configure_logs
from motiongen_server.ops.memory import settled_objects
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities

_log = logging.getLogger(__name__)

GATEWAY_GONE = 3
"""The exit code of an engine process that has lost its gateway."""


@dataclass(frozen=True)
class Built:
    """An engine that is loaded and warm, and what the gateway is told of it. threads: of the model, on the CPU."""

    engine: Engine
    facts: ModelFacts
    licence: str
    threads: int
    abilities: Abilities = NOTHING_CLAIMED


Build = Callable[[ServerConfig, Deliver, Observe, Inbox], Built]
"""Loads the model and makes the engine. Raises SettingError saying what is wrong with the settings."""


def run(folder: Path, build: Build) -> int:
    """Serve the gateway that listens in the folder. Returns the exit code: 0 after Stop, 2 for a wrong setting, 1."""
    # A terminal's Ctrl-C and a service manager's SIGTERM reach every process of the group, but it is the gateway that
    # drains; this process ends when the gateway tells it to, and at once when the gateway is gone.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    threading.Thread(target=_end_with_gateway, name="lifeline", daemon=True).start()
    end = EngineEnd(folder)
    end.back.send(GREETING.encode(Greeting(SCHEMA, time.monotonic())))
    outlet = Outlet(end.back)
    try:
        config = _begun(end.events)
        _begun(end.ahead)
        configure_logs(config.log_level, config.log_format)
        outlet.say(Joined())
        return _serve(config, build, end, outlet)
    except Exception as error:
        _log.exception("the engine process failed")
        outlet.say(Ended(f"{type(error).__name__}: {error}"))
        return 1
    finally:
        outlet.finish()
        end.close()


def _begun(socket: zmq.Socket[bytes]) -> ServerConfig:
    message = TO_ENGINE.decode(socket.recv())
    if not isinstance(message, Begin):
        raise CodecError(f"the first message was {type(message).__name__}, not Begin")
    return message.config


def _serve(config: ServerConfig, build: Build, end: EngineEnd, outlet: Outlet) -> int:
    inlet = Inlet(end, outlet, lambda: built.engine.stop())
    try:
        built = build(config, outlet.deliver, outlet.observe, inlet)
    except SettingError as error:
        outlet.say(Ended(str(error), is_setting=True))
        return 2
    with settled_objects():
        outlet.say(Ready(built.facts, built.licence, built.threads, built.abilities))
        built.engine.run()
    failure = built.engine.failure
    outlet.say(Ended("" if failure is None else f"{type(failure).__name__}: {failure}"))
    return 0 if failure is None else 1


def _end_with_gateway() -> None:
    """Standard input is held open by the gateway and nobody else; it ends when the gateway does, however that ends."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os._exit(GATEWAY_GONE)
