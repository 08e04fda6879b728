"""The command that builds and shows training sets: unusual input works, or is refused with a message."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.data import __main__ as command
from motiongen_ardy.data.dataset import DatasetError, MotionDataset
from motiongen_ardy.data.retarget_file import read_retarget
from motiongen_ardy.data.retarget_rules import RetargetError
from tests.ardy.data.captures import CORE, write_capture, write_retarget, write_table
from tests.ardy.train.clips import swinging_clip, swinging_dataset

ROW = "a,a.bvh,stand,normal,train,a person stands"


def build_arguments(folder: Path, *rows: str) -> list[str]:
    """The arguments that build a set from these rows of the table in `folder`/set."""
    write_retarget(folder / "own.yaml")
    write_table(folder / "labels.csv", *rows)
    out = str(folder / "set")
    return ["build", str(folder), str(folder / "labels.csv"), out, "--retarget", str(folder / "own.yaml")]


def test_a_set_is_built_and_unusable_captures_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = write_capture(tmp_path / "a.bvh").read_text()
    (tmp_path / "slow.bvh").write_text(whole.replace("Frame Time: 0.05", "Frame Time: 50.0"))
    (tmp_path / "cut.bvh").write_text(whole[: len(whole) // 2])
    (tmp_path / "marked.bvh").write_bytes(b"\xef\xbb\xbf" + whole.replace("\n", "\r\n").encode())
    (tmp_path / "empty.bvh").touch()
    names = ("slow", "cut", "marked", "empty", "gone")
    rows = [f"{name},{name}.bvh,stand,normal,train,a person stands" for name in names]
    assert command.main(build_arguments(tmp_path, ROW, *rows)) == 0
    document = json.loads((tmp_path / "set" / "clips.json").read_text())
    assert [clip["id"] for clip in document["clips"]] == ["a", "marked"]
    reasons = {entry["id"]: entry["reason"] for entry in document["skipped"]}
    assert "Frame Time is seconds" in reasons["slow"]
    assert "expected 40 frames, found" in reasons["cut"] or "numbers, found" in reasons["cut"]
    assert "ends too early" in reasons["empty"]
    assert "No such file" in reasons["gone"]
    assert "skipped gone" in capsys.readouterr().out


@pytest.mark.parametrize("units", ["1e40", "1000001"])  # hundredths of a metre
def test_a_capture_too_far_from_the_origin_is_skipped(
    tmp_path: Path, units: str, capsys: pytest.CaptureFixture[str]
) -> None:
    head, times = write_capture(tmp_path / "a.bvh").read_text().split("Frame Time: ")
    first, *frames = times.splitlines()
    away = [" ".join([units, *frame.split()[1:]]) for frame in frames]
    (tmp_path / "far.bvh").write_text("\n".join([f"{head}Frame Time: {first}", *away, ""]))
    assert command.main([*build_arguments(tmp_path, ROW, ROW.replace("a,a", "far,far")), "--strict"]) == 1
    assert "skipped far: it lies" in capsys.readouterr().out
    assert [clip.id for clip in MotionDataset.load(tmp_path / "set").clips] == ["a"]


def test_a_set_that_cannot_be_written_is_refused_before_it_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_capture(tmp_path / "a.bvh")
    (tmp_path / "set").touch()
    monkeypatch.setattr(command, "build", lambda *_: pytest.fail("a set was built that cannot be saved"))
    assert command.main(build_arguments(tmp_path, ROW)) == 2
    assert "no set can be written there" in capsys.readouterr().err


def test_a_full_disk_leaves_the_previous_set_intact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = swinging_dataset()
    before.save(tmp_path)
    after = replace(before, clips=tuple(replace(clip, content="run") for clip in reversed(before.clips)))

    def full(self: Path, *_: object, **__: object) -> int:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_text", full)
        with pytest.raises(DatasetError, match="No space left on device; what was there"):
            after.save(tmp_path)
    again = MotionDataset.load(tmp_path)
    assert [clip.id for clip in again.clips] == [clip.id for clip in before.clips]
    for clip, one in zip(again.clips, before.clips, strict=True):
        np.testing.assert_array_equal(clip.root_positions.numpy(), one.root_positions.numpy())


def test_rows_of_the_table_take_precedence_over_those_of_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_capture(tmp_path / "a.bvh")
    own = command.read_labels(write_table(tmp_path / "more.csv", "theirs,./a.bvh,idle,none,test,a person waits"))
    monkeypatch.setattr(command, "more_labels", lambda _: own)
    assert command.main(build_arguments(tmp_path, ROW)) == 0
    assert [clip.id for clip in MotionDataset.load(tmp_path / "set").clips] == ["a"]


def test_a_retarget_file_that_is_not_utf8_or_lacks_a_joint_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_bytes("name: Müller".encode("latin-1"))
    with pytest.raises(RetargetError, match="is not readable YAML"):
        read_retarget(path)
    names = "[LeftFoot, RightFoot, LeftToeBase]"
    with pytest.raises(RetargetError, match="feet: has 3 joints; give two for each foot, ankle and toe in turn"):
        read_retarget(write_retarget(path, f"feet: {{from: {names}, to: {names}}}\n"))


def test_labels_and_captions_with_markup_characters_can_be_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    clip = replace(swinging_clip(0, 40), content="[/wave]", captions=("pays $5_{ and $6",))
    MotionDataset(CORE, 20.0, (clip,)).save(tmp_path)
    command.main(["check", str(tmp_path)])
    assert "[/wave]" in capsys.readouterr().out
    assert command.main(["look", str(tmp_path), "--png", str(tmp_path / "new" / "clips.png")]) == 0
    assert (tmp_path / "new" / "clips.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["look", "set", "--png", "clips.png", "--rows", "0"], "--rows: must be a whole number from 1 on, not 0"),
        (["build", "a", "b", "c", "--seed", "-1"], "--seed: must be a whole number from 0 on, not -1"),
        (["build", "a", "b", "c", "--fps", "1e9"], "--fps: must be 1000 at most, as of models, not 1e9"),
    ],
)
def test_options_out_of_range_are_refused(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        command.main(arguments)
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


def test_a_picture_that_cannot_be_written_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    MotionDataset(CORE, 20.0, (swinging_clip(0, 40),)).save(tmp_path)
    assert command.main(["look", str(tmp_path), "--png", str(tmp_path / "clips.json" / "clips.png")]) == 2
    assert "cannot be written" in capsys.readouterr().err
