"""Finds and counts the fields of a message on the wire, before any of it is parsed.

Two bytes on the wire can be a message of more than a hundred bytes in memory. Fields that hold messages are followed
with the help of the contract's descriptors; a message of only numbers and text takes little more memory parsed than on
the wire, and counts as one field.
"""

from __future__ import annotations

from google.protobuf.descriptor import Descriptor

from motiongen.v1 import service_pb2, session_pb2

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
"""Wire types; see the encoding guide of Protocol Buffers."""
_FIXED_BYTES = {FIXED64: 8, FIXED32: 4}

Nested = dict[int, "Nested"]
"""The fields of a message whose messages hold messages themselves, by tag, each with its own such fields."""


class Malformed(ValueError):
    """The bytes are not a message."""


def varint(data: bytes, at: int) -> tuple[int, int]:
    """The number that begins at byte `at`, and where it ends. Raises Malformed."""
    value, shift = 0, 0
    while at < len(data):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
        if shift > 63:
            break
    raise Malformed(f"a number before byte {at} does not end")


def field(data: bytes, begin: int) -> tuple[int, int, int]:
    """The tag of the field at byte `begin`, where its content begins, and where that ends. Raises Malformed."""
    tag, at = varint(data, begin)
    wire_type = tag & 7
    if wire_type == VARINT:
        _, end = varint(data, at)
    elif wire_type == LENGTH:
        length, at = varint(data, at)
        end = at + length
    elif wire_type in _FIXED_BYTES:
        end = at + _FIXED_BYTES[wire_type]
    else:
        raise Malformed(f"wire type {wire_type} at byte {at}")
    if end > len(data):
        raise Malformed(f"a field at byte {at} ends beyond the message")
    return tag, at, end


def num_fields(data: bytes, begin: int, end: int, nested: Nested, most: int) -> int:
    """The fields of a message, and of the messages in it that `nested` names. Stops counting beyond `most`.

    begin, end: the message's bytes in data. Raises Malformed.
    """
    count = 0
    left = [(begin, end, nested)]
    while left and count <= most:
        at, end, nested = left.pop()
        while at < end and count <= most:
            tag, content, at = field(data, at)
            count += 1
            inside = nested.get(tag)
            if inside is not None:
                left.append((content, at, inside))
        if at > end and count <= most:
            raise Malformed(f"a field ends beyond its message, at byte {at}")
    return count


def nested_in(descriptor: Descriptor) -> Nested:
    """The fields of a message whose content has to be counted."""
    found: Nested = {}
    for each in descriptor.fields:
        if each.message_type is not None and any(inner.message_type for inner in each.message_type.fields):
            found[each.number << 3 | LENGTH] = nested_in(each.message_type)
    return found


EVENT = nested_in(session_pb2.DESCRIPTOR.message_types_by_name["SessionEvent"])
CLIP = nested_in(service_pb2.DESCRIPTOR.message_types_by_name["GenerateClipRequest"])
