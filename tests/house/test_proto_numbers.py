"""No number of the contract is given to something else: proto/numbers.txt keeps what each once meant."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

EXAMPLE = """Shop 1 name string
Shop 2 colours repeated Colour
Colour 0 COLOUR_UNSPECIFIED"""


def broken(noted: list[str], present: list[str], reserved: set[tuple[str, int]]) -> list[str]:
    """What was noted and holds no more. reserved: the (message or enum, number) that may be missing."""
    now = {tuple(line.split()[:2]): line for line in present}
    lost = []
    for line in noted:
        name, number = line.split()[:2]
        there = now.get((name, number))
        if there is None and (name, int(number)) not in reserved:
            lost.append(f"{line}: gone; say `reserved {number};` in {name}")
        elif there is not None and there != line:
            lost.append(f"{line}: is now {there}; take a new number")
    return lost


def reserved_numbers(files: FileDescriptorSet) -> set[tuple[str, int]]:
    found = set()
    for file in files.file:
        for message in file.message_type:
            for span in message.reserved_range:
                found |= {(message.name, number) for number in range(span.start, span.end)}
        for enum in file.enum_type:
            for each in enum.reserved_range:
                found |= {(enum.name, number) for number in range(each.start, each.end + 1)}
    return found


def test_every_number_means_what_it_meant(generator: ModuleType, repository: Any) -> None:
    noted = (repository.root / "proto" / "numbers.txt").read_text(encoding="utf-8").splitlines()
    files = generator.descriptors()
    assert broken(noted, generator.numbers(files), reserved_numbers(files)) == []
    assert sorted(set(generator.numbers(files)) - set(noted)) == [], "run `make proto` and commit what it writes"


def test_what_stays_or_is_reserved_passes() -> None:
    noted = EXAMPLE.splitlines()
    assert broken(noted, [*noted, "Shop 3 size uint32"], set()) == []
    assert broken(noted, noted[1:], {("Shop", 1)}) == []


@pytest.mark.parametrize(
    ("given", "now"),
    [
        ("Shop 1 name string", ""),
        ("Shop 1 name string", "Shop 1 name bytes"),
        ("Shop 2 colours repeated Colour", "Shop 2 colours Colour"),
        ("Colour 0 COLOUR_UNSPECIFIED", "Colour 0 COLOUR_NONE"),
    ],
)
def test_a_breach_is_seen(given: str, now: str) -> None:
    present = [line for line in EXAMPLE.replace(given, now).splitlines() if line]
    assert len(broken(EXAMPLE.splitlines(), present, set())) == 1
