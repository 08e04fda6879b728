"""What a test's own event loop has logged as errors."""

from __future__ import annotations

import logging

import pytest


def errors(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Their messages, less what gRPC says of the event loops of tests before.

    Its poller is one for a process, and may find a call of such a loop when that is closed: it tells the loop that runs
    by then, which by that is none of its own.
    """
    found = [record for record in caplog.records if record.levelno >= logging.ERROR]
    return [record.getMessage() for record in found if not _is_of_a_closed_loop(record)]


def _is_of_a_closed_loop(record: logging.LogRecord) -> bool:
    error = record.exc_info[1] if record.exc_info else None
    of_poller = record.name == "asyncio" and "PollerCompletionQueue" in record.getMessage()
    return of_poller and isinstance(error, RuntimeError) and str(error) == "Event loop is closed"
