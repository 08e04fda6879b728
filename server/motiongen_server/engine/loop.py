"""The engine's loop; runs on the thread that calls `run`."""

from __future__ import annotations

import logging

from motiongen_server.engine.engine import Engine

_log = logging.getLogger(__name__)


def run(engine: Engine) -> BaseException | None:
    """Step the engine until it is stopped, then give up its place at the device.

    An error of the engine itself ends the loop and closes every session; it is returned.
    """
    try:
        while not engine.finished:
            with engine.lease:
                report = engine.step()
            if engine.observe is not None:
                engine.observe(report)
            # If every window of this step failed (no rows, but queue waits), others may be ready: do not sleep.
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
