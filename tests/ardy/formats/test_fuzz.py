"""Malformed files: each reader reads a file or refuses it with a FormatError of a readable length."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.ardy.formats.mutations import Reader, readers
from tests.ardy.formats.refusal import read_or_refuse

NAMES = ("constraints", "root path", "npz", "client npz", "bvh", "g1 csv", "g1 controller csv")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def known(folder: Path) -> dict[str, Reader]:
    return {reader.name: reader for reader in readers(folder)}


@pytest.mark.parametrize("name", NAMES)
def test_good_files_are_read(folder: Path, known: dict[str, Reader], name: str) -> None:
    for content in known[name].good:
        assert read_or_refuse(known[name], folder / "file", content), "every mutation starts from a valid file"


@pytest.mark.parametrize("name", NAMES)
def test_any_file_is_read_or_refused(folder: Path, known: dict[str, Reader], name: str) -> None:
    reader = known[name]

    @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
    @given(content=reader.files())
    def check(content: bytes) -> None:
        read_or_refuse(reader, folder / "file", content)

    check()


def test_the_fuzzed_readers_are_those_listed_here(known: dict[str, Reader]) -> None:
    assert tuple(known) == NAMES
    assert isinstance(known["npz"].words, st.SearchStrategy)
