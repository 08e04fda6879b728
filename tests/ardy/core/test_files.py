"""A file is there whole or as it was before, whoever else writes it and whatever is there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from motiongen_ardy.core.files import written_whole


def test_what_is_there_stays_where_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    path.write_text("of yesterday")

    def write() -> None:
        with written_whole(path) as partial:
            partial.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        write()
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("walk.npz", "of yesterday")]


def test_two_writers_at_once_leave_the_file_of_one_of_them(tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    with written_whole(path) as first, written_whole(path) as second:
        first.write_text("a long first file")
        second.write_text("second")
    assert path.read_text() == "a long first file"
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_may_be_as_long_as_the_file_system_takes_it(tmp_path: Path) -> None:
    path = tmp_path / ("x" * 250)
    with written_whole(path) as partial:
        partial.write_text("new")
    assert path.read_text() == "new"


def test_a_link_goes_on_pointing_and_a_file_keeps_its_mode(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "real").chmod(0o600)
    (tmp_path / "link").symlink_to("real")
    with written_whole(tmp_path / "link") as partial:
        partial.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"
    assert (tmp_path / "real").stat().st_mode & 0o777 == 0o600


def test_a_new_file_has_the_usual_mode_whoever_writes_it(tmp_path: Path) -> None:
    (tmp_path / "usual").touch()
    with written_whole(tmp_path / "new") as partial:
        partial.touch(0o600)  # as the library of safetensors makes them
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_what_is_no_file_is_written_and_stays_what_it_is(tmp_path: Path) -> None:
    """Also by a library that puts another file in the place of what it is to write, as that of safetensors does."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(reading):
        with written_whole(pipe) as partial:
            (tmp_path / "other").write_text("new")
            (tmp_path / "other").replace(partial)
        assert os.read(reading, 10) == b"new"
    assert pipe.is_fifo()


def test_what_a_folder_is_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()

    def write() -> None:
        with written_whole(tmp_path / "folder") as partial:
            partial.write_text("new")

    with pytest.raises(IsADirectoryError):
        write()


def test_a_pipe_that_a_shell_makes_is_written_as_it_is() -> None:
    reading, writing = os.pipe()
    with os.fdopen(reading), os.fdopen(writing, "w"):
        given = Path(f"/dev/fd/{writing}")
        with written_whole(given) as partial:
            partial.write_text("new")
        assert os.read(reading, 10) == b"new"
        assert given.is_fifo()


def test_links_in_a_circle_are_told_as_the_system_tells_them(tmp_path: Path) -> None:
    (tmp_path / "one").symlink_to("other")
    (tmp_path / "other").symlink_to("one")

    def write() -> None:
        with written_whole(tmp_path / "one") as partial:
            partial.write_text("new")

    with pytest.raises(OSError, match="symbolic links"):
        write()
    assert (tmp_path / "one").is_symlink()


def test_a_link_to_what_is_not_there_yet_makes_it(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("real")
    with written_whole(tmp_path / "link") as partial:
        partial.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


def test_a_folder_that_is_not_there_is_told_by_the_name_that_was_given(tmp_path: Path) -> None:
    path = tmp_path / "none" / "walk.npz"

    def write() -> None:
        with written_whole(path) as partial:
            partial.write_text("new")

    with pytest.raises(FileNotFoundError) as refused:
        write()
    assert refused.value.filename == str(path)
