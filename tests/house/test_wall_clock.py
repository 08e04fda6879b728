"""A wall clock that jumps harms no session: the server reads it only where a date is meant."""

from __future__ import annotations

import ast
from typing import Any

CALENDAR = {
    "server/motiongen_server/identity/__main__.py": "when a token is to expire",
    "server/motiongen_server/identity/callers.py": "whether a token has expired",
    "server/motiongen_server/ops/tracing.py": "the dates of spans",
    "server/motiongen_server/snapshots/sqlite_store.py": "when a record expires that no server renews",
    "server/motiongen_server/rpc/streams/reader.py": "the server's time, which only clients are told",
}
READS = {
    "time.time",
    "time.time_ns",
    "datetime.now",
    "datetime.utcnow",
    "datetime.today",
    "date.today",
    "time.localtime",
}
LAST_WORDS = {name.rpartition(".")[2] for name in READS}


def test_wall_clock_is_read_only_where_a_date_is_meant(repository: Any) -> None:
    found = {
        path.as_posix()
        for path in repository.files
        if path.suffix == ".py" and path.parts[0] == "server"
        for node in ast.walk(ast.parse((repository.root / path).read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and node.attr in LAST_WORDS and ast.unparse(node) in READS
    }
    assert found == set(CALENDAR)
