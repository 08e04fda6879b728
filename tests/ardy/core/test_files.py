"""`written_whole`: a file has its new content or its old one, whoever else writes it and whatever its path is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from motiongen_ardy.core.files import written_whole


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    path.write_text("of yesterday")

    def write() -> None:
        with written_whole(path) as partial:
            partial.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        write()
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("walk.npz", "of yesterday")]


def test_concurrent_writers_leave_the_whole_file_of_one_of_them(tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    with written_whole(path) as first, written_whole(path) as second:
        first.write_text("a long first file")
        second.write_text("second")
    assert path.read_text() == "a long first file"
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_may_be_as_long_as_the_file_system_allows(tmp_path: Path) -> None:
    path = tmp_path / ("x" * 250)
    with written_whole(path) as partial:
        partial.write_text("new")
    assert path.read_text() == "new"


def test_a_symlink_remains_and_its_target_keeps_its_mode(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "real").chmod(0o600)
    (tmp_path / "link").symlink_to("real")
    with written_whole(tmp_path / "link") as partial:
        partial.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"
    assert (tmp_path / "real").stat().st_mode & 0o777 == 0o600


def test_a_new_file_has_the_default_mode_whatever_the_writer_sets(tmp_path: Path) -> None:
    (tmp_path / "usual").touch()
    with written_whole(tmp_path / "new") as partial:
        partial.touch(0o600)  # as the safetensors library does
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_a_named_pipe_is_written_and_remains_a_pipe(tmp_path: Path) -> None:
    """Even by a library that replaces the file that it is to write, as safetensors does."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(reading):
        with written_whole(pipe) as partial:
            (tmp_path / "other").write_text("new")
            (tmp_path / "other").replace(partial)
        assert os.read(reading, 10) == b"new"
    assert pipe.is_fifo()


def test_writing_to_a_directory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()

    def write() -> None:
        with written_whole(tmp_path / "folder") as partial:
            partial.write_text("new")

    with pytest.raises(IsADirectoryError):
        write()


def test_a_pipe_given_by_its_file_descriptor_is_written() -> None:
    reading, writing = os.pipe()
    with os.fdopen(reading), os.fdopen(writing, "w"):
        given = Path(f"/dev/fd/{writing}")
        with written_whole(given) as partial:
            partial.write_text("new")
        assert os.read(reading, 10) == b"new"
        assert given.is_fifo()


def test_circular_symlinks_raise_the_error_of_the_system(tmp_path: Path) -> None:
    (tmp_path / "one").symlink_to("other")
    (tmp_path / "other").symlink_to("one")

    def write() -> None:
        with written_whole(tmp_path / "one") as partial:
            partial.write_text("new")

    with pytest.raises(OSError, match="symbolic links"):
        write()
    assert (tmp_path / "one").is_symlink()


def test_writing_through_a_dangling_symlink_creates_its_target(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("real")
    with written_whole(tmp_path / "link") as partial:
        partial.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


def test_a_missing_folder_is_reported_with_the_path_that_was_given(tmp_path: Path) -> None:
    path = tmp_path / "none" / "walk.npz"

    def write() -> None:
        with written_whole(path) as partial:
            partial.write_text("new")

    with pytest.raises(FileNotFoundError) as refused:
        write()
    assert refused.value.filename == str(path)
