"""The wire form of every message, byte for byte: what one version writes, every later one reads."""

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
def test_a_message_is_written_and_read_as_ever(golden: Golden) -> None:
    message = golden.message
    assert message.SerializeToString(deterministic=True).hex() == golden.encoded.hex()
    assert message_type(golden.name).FromString(golden.encoded) == message


def test_every_field_of_the_contract_stands_in_a_line() -> None:
    shown: set[str] = set()
    for golden in LINES:
        shown |= shown_fields(golden.message)
    declared: set[str] = set()
    for name in message_names():
        declared |= declared_fields(name)
    assert sorted(declared - shown) == [], f"`python -m tests.contract.golden` adds them to {FILE.name}"
