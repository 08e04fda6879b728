"""Fields of the contract that the server does not serve are refused by name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import Code
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.convert.unserved import UNSERVED_FIELDS, check_served

PROTOS = Path(__file__).resolve().parents[4] / "proto" / "motiongen" / "v1"
# sent by servers alone, so there is nothing to refuse
TOLD = {"durable_seq", "spare_sessions"}
TOLD_IN = {("SessionUpdate", "snapshot")}

EXAMPLES = [
    (session_pb2.OpenSession(snapshot=b"x"), "open", "open.snapshot"),
    (session_pb2.SessionEvent(take_snapshot=session_pb2.TakeSnapshot()), "", "take_snapshot"),
]  # fmt: skip


@pytest.mark.parametrize(("message", "path", "field"), EXAMPLES, ids=[field for _, _, field in EXAMPLES])
def test_unserved_field_is_refused_by_name(message: motion_pb2.Constraint, path: str, field: str) -> None:
    with pytest.raises(EventRefused, match="does not serve it yet") as caught:
        check_served(message, path)
    assert (caught.value.code, caught.value.reason, caught.value.field) == (Code.UNIMPLEMENTED, "NOT_SERVED", field)


def test_every_refused_field_has_an_example() -> None:
    assert {field.rpartition(".")[2] for _, _, field in EXAMPLES} == {
        f for each in UNSERVED_FIELDS.values() for f in each
    }


def test_served_fields_pass() -> None:
    check_served(motion_pb2.Constraint(constraint_id=1, frame=4, waypoint=motion_pb2.Waypoint(x=1)), "upsert[0]")
    check_served(session_pb2.OpenSession(seed=1), "open")


def test_unserved_fields_are_those_marked_so_in_the_protos() -> None:
    told, message = set(), ""
    for path in PROTOS.glob("*.proto"):
        comment = ""
        for line in path.read_text(encoding="utf-8").splitlines():
            if found := re.match(r"(?:message|enum) (\w+)", line):
                message = found[1]
            if line.strip().startswith("//"):
                comment += line.strip()
                continue
            field = re.match(r"\s+(?:(?:optional|repeated) )?(?:\w+ )?(\w+) = \d+;", line)
            if field and comment.startswith("// Not served") and (message, field[1]) not in TOLD_IN:
                told.add(field[1])
            comment = ""
    assert told - TOLD == {field for fields in UNSERVED_FIELDS.values() for field in fields}
