"""Golden messages: a line for each, with its name, its content and its bytes.

`python -m tests.contract.golden` adds lines for messages with fields that no line has yet. Lines are never changed or
removed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from google.protobuf import text_format
from google.protobuf.message import Message

from motiongen.v1 import admin_pb2, encoder_pb2, motion_pb2, service_pb2, session_pb2

FILE = Path(__file__).with_name("golden_messages.txt")
MODULES = (motion_pb2, session_pb2, service_pb2, encoder_pb2, admin_pb2)


@dataclass(frozen=True)
class Golden:
    """One line. name: of the message in the package; content: text format; encoded: its bytes."""

    name: str
    content: str
    encoded: bytes

    @property
    def message(self) -> Message:
        """The message with this content."""
        return text_format.Parse(self.content, message_type(self.name)())


def golden_messages() -> list[Golden]:
    """The lines of the file."""
    rows = [line.split("\t") for line in FILE.read_text(encoding="utf-8").splitlines()] if FILE.exists() else []
    return [Golden(name, content, bytes.fromhex(encoded)) for name, content, encoded in rows]


def message_type(name: str) -> type[Message]:
    """The class of a message of the package."""
    for module in MODULES:
        if name in module.DESCRIPTOR.message_types_by_name:
            return getattr(module, name)  # type: ignore[no-any-return]
    raise LookupError(f"the contract has no message {name}")


def message_names() -> list[str]:
    """Every message of the package."""
    return [name for module in MODULES for name in module.DESCRIPTOR.message_types_by_name]


def declared_fields(name: str) -> set[str]:
    """The fields of a message by their full names."""
    return {field.full_name for field in message_type(name).DESCRIPTOR.fields}


def shown_fields(message: Message) -> set[str]:
    """The fields that are set, including those of nested messages."""
    found = set()
    for field, value in message.ListFields():
        found.add(field.full_name)
        if field.message_type is not None:
            for each in value if field.is_repeated else (value,):
                found |= shown_fields(each)
    return found


def examples(name: str) -> Iterator[Message]:
    """Messages that together set every field: one for each member of a oneof."""
    fields = message_type(name).DESCRIPTOR.fields
    # An `optional` field has its own oneof.
    members = [field for field in fields if field.containing_oneof and len(field.containing_oneof.fields) > 1]
    for member in members or [None]:
        message = message_type(name)()
        for field in fields:
            if field not in members or field is member:
                _fill(message, field)
        yield message


def _fill(message: Message, field: Any) -> None:
    if field.message_type is not None:
        inner = getattr(message, field.name)
        inner = inner.add() if field.is_repeated else inner
        inner.SetInParent()
        for each in field.message_type.fields:
            if each.message_type is None:
                _fill(inner, each)
        return
    values = {
        field.CPPTYPE_STRING: b"\x00\x01\xfe" if field.type == field.TYPE_BYTES else "a\u00e9",
        field.CPPTYPE_FLOAT: field.number + 0.5,
        field.CPPTYPE_BOOL: True,
        field.CPPTYPE_ENUM: field.enum_type.values[-1].number if field.enum_type else 0,
    }
    value = values.get(field.cpp_type, 300 + field.number)
    if field.is_repeated:
        getattr(message, field.name).extend([value, value])
    else:
        setattr(message, field.name, value)


def line(name: str, message: Message) -> str:
    content = text_format.MessageToString(message, as_one_line=True, as_utf8=False)
    return f"{name}\t{content}\t{message.SerializeToString(deterministic=True).hex()}\n"


def main() -> None:
    shown: set[str] = set()
    for golden in golden_messages():
        shown |= shown_fields(golden.message)
    lines = []
    for name in message_names():
        for example in examples(name):
            if shown_fields(example) - shown:
                shown |= shown_fields(example)
                lines.append(line(name, example))
    with FILE.open("a", encoding="utf-8") as file:
        file.writelines(lines)
    print(f"{len(lines)} lines added to {FILE.name}")


if __name__ == "__main__":
    main()
