"""The errors that a test's own event loop has logged."""

from __future__ import annotations

import logging

import pytest


def errors(caplog: pytest.LogCaptureFixture) -> list[str]:
    """The messages of errors, without gRPC's about event loops of earlier tests.

    gRPC has one poller per process. If it finds a call of an event loop that has been closed, it logs an error in the
    loop that runs now, although that one is not at fault.
    """
    found = [record for record in caplog.records if record.levelno >= logging.ERROR]
    return [record.getMessage() for record in found if not _is_of_a_closed_loop(record)]


def _is_of_a_closed_loop(record: logging.LogRecord) -> bool:
    error = record.exc_info[1] if record.exc_info else None
    of_poller = record.name == "asyncio" and "PollerCompletionQueue" in record.getMessage()
    return of_poller and isinstance(error, RuntimeError) and str(error) == "Event loop is closed"
