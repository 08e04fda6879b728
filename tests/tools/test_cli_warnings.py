"""The command line shows warnings of the client library."""

from __future__ import annotations

import logging

import pytest

from motiongen_tools.cli import warnings_shown


def test_a_warning_of_the_client_library_is_shown_once(capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("motiongen_client.session")
    before = list(logging.getLogger("motiongen_client").handlers)
    with warnings_shown():
        log.warning("session %d: %s", 0, "'jump' is outside")
    assert capsys.readouterr().err == "warning: session 0: 'jump' is outside\n"
    assert logging.getLogger("motiongen_client").handlers == before
