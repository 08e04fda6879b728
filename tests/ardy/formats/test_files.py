"""Motion files, whose format follows from their name, and the command that converts them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.formats.__main__ import main
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.files import MOTION_FORMATS, ReadOptions, format_of, read_motion, sample_paths, write_motion
from motiongen_ardy.formats.g1_csv import qpos_motion
from motiongen_ardy.formats.stored import StoredMotion
from tests.ardy.robot.poses import walking_qpos


@pytest.fixture
def walk() -> StoredMotion:
    return qpos_motion("walk", walking_qpos(26, 25), 25)


@pytest.mark.parametrize("chosen", MOTION_FORMATS, ids=lambda one: one.name)
def test_every_format_is_written_and_readable_ones_round_trip(
    tmp_path: Path, walk: StoredMotion, chosen: object
) -> None:
    suffix, readable = chosen.suffix, chosen.read is not None  # type: ignore[attr-defined]
    path = tmp_path / f"walk{suffix.upper()}"
    assert write_motion(path, walk) == ()
    assert path.stat().st_size > 1000
    if not readable:
        with pytest.raises(FormatError, match="is only written; the formats that are read are"):
            read_motion(path)
        return
    again = read_motion(path)
    assert (again.skeleton.name, again.motion.fps) == ("g134", 25)
    torch.testing.assert_close(again.positions(), walk.positions(), atol=1e-4, rtol=0)


def test_a_format_given_by_name_overrides_the_ending_of_the_file(tmp_path: Path) -> None:
    assert format_of(tmp_path / "a.controller.csv").name == "g1-controller-csv"
    assert format_of(tmp_path / "a.csv").name == "g1-csv"
    assert format_of(tmp_path / "a.csv", "npz").name == "npz"
    with pytest.raises(FormatError, match=r"tells no format; the formats are .*bvh \(\*\.bvh\)"):
        format_of(tmp_path / "a.fbx")
    with pytest.raises(FormatError, match="a Python pickle, which can run any code"):
        read_motion(tmp_path / "session.pkl")
    with pytest.raises(FormatError, match="no format 'fbx'"):
        format_of(tmp_path / "a.npz", "fbx")


def test_sample_files_are_named_as_by_ardy() -> None:
    assert sample_paths(Path("out/walk.npz"), 1) == [Path("out/walk.npz")]
    assert sample_paths(Path("out/walk.controller.csv"), 2) == [
        Path("out/walk/walk_00.controller.csv"),
        Path("out/walk/walk_01.controller.csv"),
    ]
    assert sample_paths(Path("walk.npz"), 101)[-1] == Path("walk/walk_100.npz")


def test_the_command_converts_motion_files(
    tmp_path: Path, walk: StoredMotion, capsys: pytest.CaptureFixture[str]
) -> None:
    write_motion(tmp_path / "walk.bvh", walk)
    target = tmp_path / "walk.controller.csv"
    assert main([str(tmp_path / "walk.bvh"), str(target), "--rate-hz", "50"]) == 0
    assert "26 frames of g134 at 25 a second" in capsys.readouterr().out
    assert read_motion(target).motion.fps == 50
    assert main([str(target), str(tmp_path / "walk.data"), "--to", "npz"]) == 0
    assert read_motion(tmp_path / "walk.data", name="npz").motion.num_frames == 51


def test_the_frame_rate_of_a_file_without_one_can_be_given(tmp_path: Path, walk: StoredMotion) -> None:
    write_motion(tmp_path / "walk.csv", walk)
    assert read_motion(tmp_path / "walk.csv", ReadOptions(fps=50)).motion.fps == 50


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("missing.npz", "out.bvh"), "No such file"),
        (("walk.csv", "out.xyz"), "the name tells no format"),
        (("walk.csv", "out.controller.csv", "--rate-hz", "0"), "the rate is 0.0 Hz"),
        (("walk.csv", "out.npz", "--fps", "0.5"), "give a whole number"),
        (
            ("walk.csv", "out.npz", "--rate-hz", "50"),
            "leave out --rate-hz",
        ),
        (("walk.npz", "out.bvh", "--fps", "50"), "leave out --fps"),
        (("walk.csv", "out.npz", "--from", "npz"), "not a readable NPZ"),
    ],
)
def test_the_command_reports_errors_on_stderr(
    tmp_path: Path, walk: StoredMotion, capsys: pytest.CaptureFixture[str], names: tuple[str, ...], message: str
) -> None:
    write_motion(tmp_path / "walk.csv", walk)
    paths = [str(tmp_path / name) if "." in name and not name[0].isdigit() else name for name in names]
    assert main(paths) == 1
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert message in said.err
    assert said.out == ""


def test_a_full_disk_is_reported_with_the_file(
    tmp_path: Path, walk: StoredMotion, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    write_motion(tmp_path / "walk.npz", walk)
    monkeypatch.setattr(np, "savetxt", full)
    assert main([str(tmp_path / "walk.npz"), str(tmp_path / "walk.bvh")]) == 1
    assert capsys.readouterr().err == f"error: {tmp_path / 'walk.bvh'}: [Errno 28] No space left on device\n"
    assert list(tmp_path.iterdir()) == [tmp_path / "walk.npz"]


def test_a_motion_on_standard_output_is_all_that_is_there(tmp_path: Path, walk: StoredMotion) -> None:
    write_motion(tmp_path / "walk.npz", walk)
    asked = [sys.executable, "-m", "motiongen_ardy.formats", str(tmp_path / "walk.npz"), "/dev/stdout", "--to", "bvh"]
    done = subprocess.run(asked, capture_output=True, text=True, check=True)
    assert done.stderr == "/dev/stdout: 26 frames of g134 at 25 a second\n"
    (tmp_path / "again.bvh").write_text(done.stdout)
    assert read_motion(tmp_path / "again.bvh").motion.num_frames == 26
