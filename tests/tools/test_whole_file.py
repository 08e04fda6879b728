"""`whole_file`: a file has its new content or its old one, whatever fails while it is written."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motiongen_client import Motion
from motiongen_tools import ardy_npz, bvh, npz
from motiongen_tools.conversion import ConversionFailed, convert_file, convert_to_npz
from motiongen_tools.whole_file import whole_file


def fail(*_: object, **__: object) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize(
    ("write", "name", "last"),
    [
        (npz.write_npz, "walk.npz", "savez_compressed"),
        (ardy_npz.write_ardy_npz, "walk.npz", "savez"),
        (bvh.write_bvh, "walk.bvh", "savetxt"),
    ],
)
def test_a_full_disk_leaves_the_old_file(
    write: Callable[[Path, Motion], None], name: str, last: str,
    stick_motion: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    (tmp_path / name).write_text("of yesterday")
    monkeypatch.setattr(np, last, fail)
    with pytest.raises(OSError, match=f"No space left on device: '{tmp_path / name}'$"):
        write(tmp_path / name, stick_motion)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "of yesterday")]


def test_a_converter_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pretended = tmp_path / "python"
    fails = 'echo half > "$last"; echo "error: $last: full" >&2; exit 1'
    pretended.write_text(f"#!/bin/sh\nfor last; do :; done\n{fails}\n")
    pretended.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(pretended))
    target = tmp_path / "walk.glb"
    target.write_text("of yesterday")
    with pytest.raises(ConversionFailed) as failure:
        convert_file(tmp_path / "walk.npz", target)
    assert str(failure.value) == f"walk.glb: the converter failed: {target}: full"
    assert target.read_text() == "of yesterday"


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("error: $source: line 1: expected HIERARCHY", "walk.bvh: line 1: expected HIERARCHY"),
        ("No module named motiongen_ardy", "walk.bvh: the converter failed: it is not installed here"),
    ],
)
def test_failed_reading_names_the_uploaded_file_and_no_temporary_one(
    said: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretended = tmp_path / "python"
    pretended.write_text(f'#!/bin/sh\nfor each; do source="$target"; target="$each"; done\necho "{said}" >&2; exit 1\n')
    pretended.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(pretended))
    with pytest.raises(ConversionFailed) as failure:
        convert_to_npz(tmp_path / "motion.bvh", tmp_path / "converted.npz", source_name="walk.bvh")
    assert str(failure.value).startswith(told)
    assert str(tmp_path) not in str(failure.value)
    assert "converted" not in str(failure.value)


@pytest.mark.parametrize("name", ["-walk.bvh", "--fps.bvh", "日本 walk.bvh"])
def test_a_file_name_is_never_taken_as_an_option_of_the_converter(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretended = tmp_path / "python"
    pretended.write_text('#!/bin/sh\nfor last; do :; done\nfor each; do printf "%s\\n" "$each"; done > "$last"\n')
    pretended.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(pretended))
    monkeypatch.chdir(tmp_path)
    assert convert_file(Path("-in.npz"), Path(name)) == []
    source, target = Path(name).read_text().splitlines()[2:]
    assert source == str(tmp_path / "-in.npz")
    assert Path(target).is_absolute()
    assert Path(target).name == name


def test_a_symlink_remains_and_its_target_keeps_its_mode(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "real").chmod(0o600)
    (tmp_path / "link").symlink_to("real")
    with whole_file(tmp_path / "link") as part:
        part.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"
    assert (tmp_path / "real").stat().st_mode & 0o777 == 0o600


def full_disk(_: Path) -> None:
    fail()


def gone_folder(part: Path) -> None:
    part.parent.rmdir()
    part.write_text("new")


@pytest.mark.parametrize("write", [full_disk, gone_folder])
def test_a_failure_names_the_file_that_was_given(write: Callable[[Path], None], tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"walk\.npz") as failure, whole_file(tmp_path / "walk.npz") as part:
        write(part)
    assert failure.value.filename == str(tmp_path / "walk.npz")


def test_a_named_pipe_is_written_directly(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with whole_file(tmp_path / "pipe") as part:
        assert part == tmp_path / "pipe"
    assert (tmp_path / "pipe").is_fifo()


def test_a_link_to_a_file_of_another_name_is_converted_by_its_own_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretended = tmp_path / "python"
    pretended.write_text('#!/bin/sh\nfor last; do :; done\necho "${last##*/}" > "$last"\n')
    pretended.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(pretended))
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "0a1b").write_text("of yesterday")
    (tmp_path / "walk.glb").symlink_to(tmp_path / "kept" / "0a1b")
    convert_file(tmp_path / "walk.npz", tmp_path / "walk.glb")
    assert (tmp_path / "walk.glb").is_symlink()
    assert (tmp_path / "kept" / "0a1b").read_text() == "walk.glb\n"


def test_a_full_device_is_named_as_it_was_given(
    stick_motion: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "walk.bvh").symlink_to("/dev/null")
    monkeypatch.setattr(np, "savetxt", fail)
    with pytest.raises(OSError, match=f"No space left on device: '{tmp_path / 'walk.bvh'}'$"):
        bvh.write_bvh(tmp_path / "walk.bvh", stick_motion)
