"""The engine's loop, on whichever thread runs it."""

from __future__ import annotations

import logging

from motiongen_server.engine.engine import Engine

_log = logging.getLogger(__name__)


def run(engine: Engine) -> BaseException | None:
    """Go round until the engine is stopped, then leave the device.

    An error of the engine itself ends the loop and closes every session; it is returned.
    """
    try:
        while not engine.finished:
            with engine.lease:
                report = engine.step()
            if engine.observe is not None:
                engine.observe(report)
            # Where no window of a step could be made, others may wait for the next one.
            if not report.rows and not report.queue_waits:
                engine.wait()
        engine.end_drained()
    except Exception as error:
        _log.exception("the engine's loop failed")
        engine.end_failed()
        return error
    finally:
        engine.lease.leave()
    return None
