"""The encoding of every message, byte for byte: later versions read what earlier ones wrote."""

from __future__ import annotations

import pytest

from tests.contract.golden import (
    FILE,
    Golden,
    declared_fields,
    golden_messages,
    message_names,
    message_type,
    shown_fields,
)

LINES = golden_messages()


@pytest.mark.parametrize("golden", LINES, ids=lambda golden: golden.name)
def test_encoding_of_a_message_is_unchanged(golden: Golden) -> None:
    message = golden.message
    assert message.SerializeToString(deterministic=True).hex() == golden.encoded.hex()
    assert message_type(golden.name).FromString(golden.encoded) == message


def test_golden_messages_cover_every_field() -> None:
    shown: set[str] = set()
    for golden in LINES:
        shown |= shown_fields(golden.message)
    declared: set[str] = set()
    for name in message_names():
        declared |= declared_fields(name)
    assert sorted(declared - shown) == [], f"`python -m tests.contract.golden` adds them to {FILE.name}"
