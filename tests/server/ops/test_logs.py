"""The formats of log lines, and where they go."""

from __future__ import annotations

import json
import logging
import re
import sys
from collections.abc import Iterator

import pytest

from motiongen_server.ops.logs import JsonFormatter, configure_logs


@pytest.fixture
def root_logger() -> Iterator[logging.Logger]:
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield root
    root.handlers[:] = handlers
    root.setLevel(level)


def test_json_line_has_time_level_logger_and_message() -> None:
    record = logging.LogRecord(
        "motiongen_server.rpc.service", logging.WARNING, "x.py", 1, "lost %d of\n%s", (3, "ten"), None
    )
    line = JsonFormatter().format(record)
    assert "\n" not in line
    told = json.loads(line)
    assert (told["level"], told["logger"], told["message"]) == (
        "WARNING",
        "motiongen_server.rpc.service",
        "lost 3 of\nten",
    )
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", told["time"])
    assert "exception" not in told


def test_json_line_has_the_traceback() -> None:
    try:
        raise ValueError("broken")
    except ValueError:
        record = logging.LogRecord("motiongen_server", logging.ERROR, "x.py", 1, "failed", (), sys.exc_info())
    told = json.loads(JsonFormatter().format(record))
    assert "ValueError: broken" in told["exception"]


@pytest.mark.parametrize("form", ["text", "json"])
def test_lines_from_the_level_up_go_to_standard_error(
    form: str, root_logger: logging.Logger, capsys: pytest.CaptureFixture[str]
) -> None:
    configure_logs("WARNING", form)
    logging.getLogger("motiongen_server.app").info("quiet")
    logging.getLogger("motiongen_server.app").warning("loud")
    streams = capsys.readouterr()
    assert streams.out == ""
    (line,) = streams.err.splitlines()
    assert "loud" in line
    assert (
        (json.loads(line)["message"] == "loud")
        if form == "json"
        else line.endswith("WARNING motiongen_server.app: loud")
    )
