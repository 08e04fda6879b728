"""The command line shows what the library warns of."""

from __future__ import annotations

import logging

import pytest

from motiongen_tools.cli import warnings_shown


def test_the_command_line_shows_what_the_library_warns_of_once(capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("motiongen_client.session")
    before = list(logging.getLogger("motiongen_client").handlers)
    with warnings_shown():
        log.warning("session %d: %s", 0, "'jump' is outside")
    assert capsys.readouterr().err == "warning: session 0: 'jump' is outside\n"
    assert logging.getLogger("motiongen_client").handlers == before
