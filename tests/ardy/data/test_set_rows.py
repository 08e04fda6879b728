"""A training set whose rows were edited by hand: mistakes are reported, not trained on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motiongen_ardy.data import __main__ as command
from motiongen_ardy.data.dataset import DatasetError, MotionDataset
from tests.ardy.train.clips import swinging_dataset

SEGMENT = {"start": 0, "length": 4, "content": "walk", "captions": ["a person walks"]}


def first(**changes: Any) -> dict[str, Any]:
    return {"clips": changes}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (first(captions="a person walks"), r"clip 0 \(swing-0\): captions is 'a person walks', no list"),
        (first(captions=[5]), "captions are no list of texts"),
        (first(start=5), "it starts at 0, where the last one ends"),
        (first(start=-5), "it starts at 0, where the last one ends"),
        (first(length="12"), "length is '12', no int"),
        (first(length=True), "length is 'True', no int"),
        (first(figures=None), "figures is 'None', no dict"),
        (first(segments=[{**SEGMENT, "captions": "walks"}]), "a segment: captions is 'walks', no list"),
        (first(segments=[{**SEGMENT, "start": 10}]), "a segment of 4 frames from 10 on, of 12"),
        (first(segments=[{"start": 0}]), "a segment: length is missing"),
        ({"fps": 0}, "fps is 0, no number above 0"),
        ({"fps": float("nan")}, "fps is nan, no number above 0"),
        ({"fps": "20"}, "fps is '20', no int or float"),
        ({"skeleton": 27}, "skeleton is '27', no str"),
    ],
)
def test_an_invalid_value_in_the_rows_is_reported(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    swinging_dataset().save(tmp_path)
    document = json.loads((tmp_path / "clips.json").read_text())
    document["clips"][0] |= changes.pop("clips", {})
    (tmp_path / "clips.json").write_text(json.dumps(document | changes))
    with pytest.raises(DatasetError, match=message):
        MotionDataset.load(tmp_path)


@pytest.mark.parametrize("name", ["fps", "skeleton", "clips", "skipped"])
def test_a_missing_field_is_reported_without_a_traceback(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    swinging_dataset().save(tmp_path)
    document = json.loads((tmp_path / "clips.json").read_text())
    del document[name]
    (tmp_path / "clips.json").write_text(json.dumps(document))
    assert command.main(["check", str(tmp_path)]) == 2
    assert f"{name} is missing; mend it, or build the set again" in capsys.readouterr().err


def test_other_float_types_are_read_and_motion_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    dataset = swinging_dataset()
    dataset.save(tmp_path)
    with np.load(tmp_path / "motion.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "motion.npz", **{name: array.astype(">f8") for name, array in arrays.items()})
    again = MotionDataset.load(tmp_path)
    np.testing.assert_array_equal(again.clips[1].root_positions.numpy(), dataset.clips[1].root_positions.numpy())
    arrays["root_positions"][3, 0] = np.nan
    np.savez(tmp_path / "motion.npz", **arrays)
    with pytest.raises(DatasetError, match=r"motion\.npz: cannot be read: root_positions holds float32, or NaN"):
        MotionDataset.load(tmp_path)
