"""Malformed files: each reader reads a file or refuses it with a FormatError of a readable length."""

from __future__ import annotations

import inspect
import pkgutil
import sys
from importlib import import_module
from pathlib import Path
from types import CodeType, FrameType

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motiongen_ardy import formats
from motiongen_ardy.formats.files import MOTION_FORMATS, MotionFormat, read_motion
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


def test_every_reader_of_the_package_is_given_such_files(folder: Path, known: dict[str, Reader]) -> None:
    assert tuple(known) == NAMES
    called: set[CodeType] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        called.add(frame.f_code)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        for reader in known.values():
            read_or_refuse(reader, folder / "file", reader.good[0])
    finally:
        sys.setprofile(before)
    modules = [import_module(f"{formats.__name__}.{module.name}") for module in pkgutil.iter_modules(formats.__path__)]
    defined = {
        name: function.__code__
        for module in modules
        for name, function in inspect.getmembers(module, inspect.isfunction)
        if name.startswith("read_") and function.__module__ == module.__name__
    }
    missing = {name for name, code in defined.items() if code not in called}
    assert missing == {read_motion.__name__}, "that one chooses among the formats"


@pytest.mark.parametrize("chosen", [one for one in MOTION_FORMATS if one.read], ids=lambda one: one.name)
def test_every_format_that_is_read_has_files_to_change(
    folder: Path, known: dict[str, Reader], chosen: MotionFormat
) -> None:
    through = Reader(chosen.name, lambda path: read_motion(path, name=chosen.name), (), st.nothing())
    files = [content for reader in known.values() for content in reader.good]
    assert any(read_or_refuse(through, folder / "file", content) for content in files)
