"""Runs the application until a signal, and ends the process with its exit code."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import sys
from typing import NoReturn

from motiongen_server.app import Application, MakeEngines, StoppedEarly
from motiongen_server.config import ServerConfig
from motiongen_server.engine_process.connection import EngineLost
from motiongen_server.engine_process.pool import start_engine_processes
from motiongen_server.ops.memory import settled_objects
from motiongen_server.settings import SettingError

_log = logging.getLogger("motiongen_server")

SIGNALS = (signal.SIGTERM, signal.SIGINT)


def stop_on_signals(application: Application) -> None:
    """Drain on the first signal, without waiting for clients on the second; a third one ends the process at once."""
    loop, asked_before = asyncio.get_running_loop(), 0

    def asked() -> None:
        nonlocal asked_before
        asked_before += 1
        application.ask_to_stop()
        if asked_before > 1:
            for number in SIGNALS:
                loop.remove_signal_handler(number)
                signal.signal(number, signal.SIG_DFL)

    for number in SIGNALS:
        loop.add_signal_handler(number, asked)


async def run(config: ServerConfig, make_engines: MakeEngines = start_engine_processes) -> int:
    """Start, serve until SIGTERM or SIGINT, drain. Returns the process's exit code."""
    application = Application(config, make_engines)
    stop_on_signals(application)
    try:
        await application.start()
    except SettingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except EngineLost as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except StoppedEarly:
        _log.info("stopped before it was ready")
        return 0
    with settled_objects():
        await application.serve()
        return await application.drain()


def leave(exit_code: int) -> NoReturn:
    """End the process at once, after everything has been cleaned up.

    The interpreter's normal exit would tear down what libraries' threads still use: that crashed once after a drain, on
    a busy machine.
    """
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # the process was started without it
            with contextlib.suppress(OSError, ValueError):  # full, closed, or nobody reads it
                stream.flush()
    os._exit(exit_code)
