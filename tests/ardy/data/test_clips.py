"""Labels, mirroring, resampling, captions, retarget files, and the training set on disk."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.core.rotation import matrix_from_6d, matrix_to_quaternion, quaternion_to_matrix, rotation_y
from motiongen_ardy.core.skeleton import forward_kinematics, load_skeleton
from motiongen_ardy.data.captions import mirror_caption, mirror_content, paraphrases
from motiongen_ardy.data.dataset import DatasetError, MotionDataset
from motiongen_ardy.data.labels import LabelsError, read_labels
from motiongen_ardy.data.mirror import mirror_clip
from motiongen_ardy.data.resample import resample, resampled_length
from motiongen_ardy.data.retarget_file import built_in_retargets, read_retarget
from motiongen_ardy.data.retarget_rules import RetargetError
from tests.ardy.data.captures import write_retarget
from tests.ardy.train.clips import swinging_dataset

CORE = load_skeleton("core27")


def labels_table(path: Path, texts: str, encoding: str = "utf-8") -> Path:
    rows = f"id,file,content,style,texts,split\na,a.bvh,walk,normal,{texts},train\n"
    path.write_text(rows, encoding=encoding)
    return path


def test_a_labels_table_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    (label,) = read_labels(labels_table(tmp_path / "marked.csv", "he walks|she walks", "utf-8-sig"))
    assert (label.id, label.texts) == ("a", ("he walks", "she walks"))


def test_a_clip_without_a_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LabelsError, match="line 2: column texts has no text"):
        read_labels(labels_table(tmp_path / "bars.csv", "| |"))


def test_an_id_with_a_plus_sign_is_refused(tmp_path: Path) -> None:
    path = labels_table(tmp_path / "plus.csv", "he walks")
    path.write_text(path.read_text().replace("\na,", "\na+b,"))
    with pytest.raises(LabelsError, match=r"line 2: id 'a\+b' has a \+"):
        read_labels(path)


@pytest.mark.parametrize(("skeleton", "fps"), [("g134", 20), ("core27", 25)])
def test_a_model_of_another_skeleton_or_frame_rate_is_refused(skeleton: str, fps: int) -> None:
    dataset = swinging_dataset()
    dataset.require("core27", 20)
    with pytest.raises(DatasetError, match=rf"core27 at 20 frames a second, the model of {skeleton} at {fps}; build"):
        dataset.require(skeleton, fps)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_mirroring_swaps_sides_and_is_its_own_inverse(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    quaternions = matrix_to_quaternion(matrix_from_6d(torch.randn(3, 27, 6, generator=generator)))
    root = torch.randn(3, 3, generator=generator)
    mirrored, moved = mirror_clip(CORE, quaternions, root)
    again, back = mirror_clip(CORE, mirrored, moved)
    torch.testing.assert_close(again, quaternions)
    torch.testing.assert_close(back, root)
    _, before = forward_kinematics(CORE, quaternion_to_matrix(quaternions), root)
    _, after = forward_kinematics(CORE, quaternion_to_matrix(mirrored), moved)
    left, right = CORE.index("LeftHand"), CORE.index("RightHand")
    flipped = before[:, left] * torch.tensor([-1.0, 1.0, 1.0])
    torch.testing.assert_close(after[:, right], flipped, atol=2e-3, rtol=0)


@pytest.mark.parametrize(("frames", "expected"), [(1, 1), (2, 1), (4, 3), (91, 61)])
def test_number_of_resampled_frames(frames: int, expected: int) -> None:
    assert resampled_length(frames, 30, 20) == expected


def test_resampling_keeps_a_constant_rate_over_several_turns() -> None:
    angles = torch.arange(31).double() * 0.3  # far beyond one turn
    rotations = rotation_y(angles)[:, None]
    positions = angles[:, None, None].expand(-1, 1, 3)
    turned, moved = resample(rotations, positions, 30, 20)
    expected = torch.arange(len(turned)).double() * 0.45
    torch.testing.assert_close(turned[:, 0], rotation_y(expected), atol=1e-9, rtol=0)
    torch.testing.assert_close(moved[:, 0, 0], expected, atol=1e-9, rtol=0)


def test_mirrored_captions_swap_sides_and_keep_their_case() -> None:
    assert mirror_caption("Left, then the right hand; leftover") == "Right, then the left hand; leftover"
    assert mirror_content("walk-turn-left") == "walk-turn-right"
    assert mirror_caption(mirror_caption("a person turns left")) == "a person turns left"


def test_captions_of_a_normal_style_differ_from_those_of_other_styles() -> None:
    plain, styled = paraphrases("walk", "normal"), paraphrases("walk", "elderly")
    assert "a person walks forward" in plain
    assert not set(plain) & set(styled)
    assert len(set(plain)) == len(plain) <= 30
    assert paraphrases("walk", "no such style") == ()


def test_the_built_in_retargets_can_be_read() -> None:
    names = {retarget.name for retarget in built_in_retargets()}
    assert names == {"bandai_namco", "cmu", "cmu_bvh", "react_idle"}
    assert all(retarget.skeleton is CORE for retarget in built_in_retargets())


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (f"metres_per_unit: 1{400 * '0'}", "a whole number of 401 characters"),
        ("metres_per_unit: 2020-13-01", "is not readable YAML"),
        ("metres_per_unit: " + 1000 * "[", "nested too deeply"),
        ("metres_per_unit: 1\nmetres_per_unit: 100", "gives the keys 'metres_per_unit' twice"),
        ("metres_per_unit: \udcff", "is not readable YAML"),
    ],
)
def test_invalid_yaml_is_refused_as_a_retarget(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(f"name: mine\nskeleton: core27\n{line}\n", encoding="utf-8", errors="surrogateescape")
    with pytest.raises(RetargetError, match=message):
        read_retarget(path)


@pytest.mark.parametrize(
    ("there", "wanted", "message"),
    [
        ("scale: 1.0", "scale: {from: [[Hips, LeftUpLeg]], to: [[Hips]]}", "root.scale.to: a chain of one joint"),
        ("scale: 1.0", "scale: {from: [[Hips]], to: [[Hips, LeftUpLeg]]}", "root.scale.from: a chain of one joint"),
        ("  Neck: {from: Neck}\n", "", r"fill.Neck.fraction: must be 0\.\.1; found 1\.5"),
    ],
)
def test_a_retarget_with_invalid_proportions_is_refused(tmp_path: Path, there: str, wanted: str, message: str) -> None:
    fill = "" if wanted else "fill: {Neck: {between: [Hips, Head], fraction: 1.5}}\n"
    path = write_retarget(tmp_path / "mine.yaml", fill)
    path.write_text(path.read_text().replace(there, wanted))
    with pytest.raises(RetargetError, match=message):
        read_retarget(path)


def test_a_large_integer_is_accepted_as_a_scale(tmp_path: Path) -> None:
    path = write_retarget(tmp_path / "mine.yaml")
    path.write_text(path.read_text().replace("scale: 1.0", f"scale: 1{31 * '0'}"))
    assert read_retarget(path).scale == 1e31


def test_a_retarget_file_with_an_unknown_key_lists_the_known_ones(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nskeleton: core27\nbones: {}\n")
    with pytest.raises(RetargetError, match="joints"):
        read_retarget(path)


def test_a_training_set_round_trips_through_its_files(tmp_path: Path) -> None:
    dataset = swinging_dataset()
    dataset.save(tmp_path, skipped=[("bad", "it has no frames")])
    again = MotionDataset.load(tmp_path, "train")
    assert [clip.id for clip in again.clips] == [clip.id for clip in dataset.clips]
    for before, after in zip(dataset.clips, again.clips, strict=True):
        assert torch.equal(before.local_rotations, after.local_rotations)
        assert before.captions == after.captions
    with pytest.raises(DatasetError, match="train"):
        MotionDataset.load(tmp_path, "validation")
    (tmp_path / "clips.json").unlink()
    with pytest.raises(DatasetError, match=r"ardy\.data build"):
        MotionDataset.load(tmp_path)
