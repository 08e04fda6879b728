"""Refuses what the contract defines but this server does not serve yet, instead of ignoring it silently."""

from __future__ import annotations

from google.protobuf.message import Message

from motiongen_server.engine.types import Code
from motiongen_server.errors import EventRefused

UNSERVED_FIELDS: dict[str, tuple[str, ...]] = {
    "OpenSession": ("snapshot",),
    "SessionEvent": ("take_snapshot",),
}  # fmt: skip
"""Fields by message. Their comments in the protos begin with "Not served"; a test checks that."""


def check_served(message: Message, field: str) -> None:
    """Raise EventRefused if the message sets a field that is not served. field: the message's path, "" for an event."""
    present = {descriptor.name for descriptor, _ in message.ListFields()}
    for name in UNSERVED_FIELDS.get(message.DESCRIPTOR.name, ()):
        if name in present:
            raise not_served(f"{field}.{name}".lstrip("."), "leave it out")


def not_served(field: str, allowed: str) -> EventRefused:
    return EventRefused(
        Code.UNIMPLEMENTED,
        "NOT_SERVED",
        f"{field.rpartition('.')[2]} is part of the contract, but this server does not serve it yet",
        field=field,
        allowed=allowed,
    )
