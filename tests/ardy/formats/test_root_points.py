"""Root points, sparse or one per frame: written, read, and turned into constraints."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.root_points import RootPoints, read_root_points, write_root_points

POINT = st.tuples(*[st.floats(-1e4, 1e4, width=32)] * 3)


@settings(max_examples=40, deadline=None)
@given(first=st.integers(0, 10**9 - 10), points=st.lists(POINT, max_size=8), dense=st.booleans(), data=st.data())
def test_root_points_round_trip(
    tmp_path_factory: pytest.TempPathFactory,
    first: int,
    points: list[tuple[float, float, float]],
    dense: bool,
    data: st.DataObject,
) -> None:
    count = len(points)
    frames = tuple(range(first, first + count))
    if not dense:
        frames = tuple(sorted(data.draw(st.sets(st.integers(0, 10**9 - 1), min_size=count, max_size=count))))
    path = tmp_path_factory.getbasetemp() / "path.json"
    write_root_points(path, RootPoints(frames, torch.tensor(points).reshape(-1, 3), dense))
    again = read_root_points(path)
    assert (again.frames, again.dense) == (frames, dense)
    assert again.points.tolist() == [list(point) for point in points]


def test_both_forms_are_read_and_a_missing_type_means_keyframes(tmp_path: Path) -> None:
    path = tmp_path / "path.json"
    path.write_text(
        '{"type": "dense_trajectory", "trajectory": {"11": [1, 0, 2], "10": [0.5, 0, 1.5], "9": [0, 0, 1]}}'
    )
    dense = read_root_points(path)
    assert (dense.frames, dense.dense) == ((9, 10, 11), True)
    constraint = dense.constraint()
    assert constraint.frames == (9, 10, 11)
    assert constraint.ground.tolist() == [[0, 1], [0.5, 1.5], [1, 2]]
    assert constraint.heading is None
    path.write_text('{"keyframes": {"0": [0, 0.9, 0], "60": [3, 0.9, 4]}}')
    assert read_root_points(path).frames == (0, 60)
    assert not read_root_points(path).dense


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "the file holds a list"),
        ({"type": "spline", "keyframes": {}}, "type is 'spline'; it must be one of keyframes, dense_trajectory"),
        ({"type": ["keyframes"], "keyframes": {}}, "type is list"),
        ({"type": "dense_trajectory", "keyframes": {"0": [0, 0, 0]}}, "trajectory is None"),
        ({"keyframes": [[0, 0, 0]]}, "keyframes is list; give an object"),
        ({"keyframes": {"-1": [0, 0, 0]}}, "a frame called '-1'"),
        ({"keyframes": {"01": [0, 0, 0]}}, "a frame called '01'"),
        ({"keyframes": {"1.5": [0, 0, 0]}}, "a frame called '1.5'"),
        ({"keyframes": {"٣": [0, 0, 0]}}, "a frame called"),
        ({"keyframes": {"9" * 40: [0, 0, 0]}}, "a frame called"),
        ({"keyframes": {"1": [0, 0]}}, r"at \[0\]: a list of 2; give \[x, y, z\]"),
        ({"keyframes": {"1": [0, "0", 0]}}, r"'0' at \[0, 1\]"),
        ({"keyframes": {"1": None}}, r"None at \[0\]"),
        ({"type": "dense_trajectory", "trajectory": {"1": [0, 0, 0], "3": [0, 0, 0]}}, "no point after frame 1"),
        ({"keyframes": {"1": [1e39, 0, 0]}}, "NaN or infinite"),
    ],
)
def test_invalid_root_points_are_refused(tmp_path: Path, content: object, message: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(content))
    with pytest.raises(FormatError, match=message):
        read_root_points(path)


def test_frames_beyond_the_clip_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "path.json"
    write_root_points(path, RootPoints((3, 60), torch.zeros(2, 3)))
    assert read_root_points(path, num_frames=61).frames == (3, 60)
    with pytest.raises(FormatError, match="whole numbers of 0 to 59"):
        read_root_points(path, num_frames=60)


@pytest.mark.parametrize("frames", [(3, 2), (2, 2), (-1, 0)])
def test_frames_out_of_order_are_refused(frames: tuple[int, int]) -> None:
    with pytest.raises(FormatError, match="not in order"):
        RootPoints(frames, torch.zeros(2, 3))
