"""Root paths in the JSON form that ARDY's demo imports and exports: points over the ground by frame.

`{"type": "keyframes", "keyframes": {"12": [x, y, z]}}`, or `{"type": "dense_trajectory", "trajectory": {...}}` with a
point for every frame of one span. Without a type, keyframes are assumed. Metres, +Y up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.formats.bounded import MAX_FRAMES, MAX_JSON_BYTES, read_text
from motiongen_ardy.formats.constraints import RootConstraint
from motiongen_ardy.formats.errors import FormatError, shortened
from motiongen_ardy.formats.json_text import NumbersError, numbers, parse_json, write_json

_FIELDS = {"keyframes": "keyframes", "dense_trajectory": "trajectory"}
_MAX_FRAME_DIGITS = 9


@dataclass(frozen=True, eq=False)
class RootPoints:
    """Points (K, 3) in metres at ascending frames (K); dense: every frame from the first to the last has one.

    Raises FormatError for frames out of order, gaps in a dense path, and points that are not finite.
    """

    frames: tuple[int, ...]
    points: Tensor
    dense: bool = False
    source: str = "root path"

    def __post_init__(self) -> None:
        if tuple(self.points.shape) != (len(self.frames), 3):
            given = f"points of shape {tuple(self.points.shape)}"
            raise FormatError(self.source, given, f"give ({len(self.frames)}, 3): x, y, z at each frame")
        if not self.points.isfinite().all():
            raise FormatError(self.source, "points hold NaN or infinite numbers", "every one must be finite")
        steps = [after - before for before, after in zip(self.frames, self.frames[1:], strict=False)]
        if any(step < 1 for step in steps) or (self.frames and self.frames[0] < 0):
            raise FormatError(self.source, "frames below 0, or not in order", "give each frame once, from 0 up")
        if self.dense and any(step != 1 for step in steps):
            gap = next(frame for frame, step in zip(self.frames, steps, strict=False) if step != 1)
            raise FormatError(self.source, f"no point after frame {gap}", "a dense trajectory has one at every frame")

    def constraint(self) -> RootConstraint:
        """The path as a constraint on x and z at its frames. The height of the points is ignored."""
        return RootConstraint(self.frames, self.points[:, [0, 2]])


def read_root_points(path: Path, num_frames: int | None = None) -> RootPoints:
    """Read a path, for a clip of num_frames frames (None: of any length). Raises FormatError, and OSError."""
    content = parse_json(read_text(path, MAX_JSON_BYTES), path)
    if not isinstance(content, Mapping):
        raise FormatError(path, f"the file holds a {type(content).__name__}", "give an object with type and points")
    kind = content.get("type", "keyframes")
    if not isinstance(kind, str) or kind not in _FIELDS:
        raise FormatError(path, f"type is {shortened(kind)}", f"it must be one of {', '.join(_FIELDS)}")
    listed = content.get(_FIELDS[kind])
    if not isinstance(listed, Mapping) or len(listed) > MAX_FRAMES:
        given = f"{_FIELDS[kind]} is {shortened(listed)}"
        raise FormatError(path, given, f"give an object of [x, y, z] by frame, {MAX_FRAMES} at most")
    by_frame = {_frame(path, name, num_frames): point for name, point in listed.items()}
    frames = tuple(sorted(by_frame))
    try:
        points = torch.from_numpy(numbers([by_frame[frame] for frame in frames], (len(frames), 3))).float()
    except NumbersError as error:
        raise FormatError(path, f"{_FIELDS[kind]} is {error}", "give [x, y, z] in metres at each frame") from None
    return RootPoints(frames, points, kind == "dense_trajectory", str(path))


def _frame(path: Path, name: str, num_frames: int | None) -> int:
    """The frame that a field names, without sign, blanks or leading zeros, so that no frame can be named twice."""
    plain = name.isascii() and name.isdecimal() and len(name) <= _MAX_FRAME_DIGITS and str(int(name)) == name
    if not plain or (num_frames is not None and int(name) >= num_frames):
        last = 10**_MAX_FRAME_DIGITS - 1 if num_frames is None else num_frames - 1
        raise FormatError(path, f"a frame called {shortened(name)}", f"frames are whole numbers of 0 to {last}")
    return int(name)


def write_root_points(path: Path, root_path: RootPoints) -> None:
    """Write a path in the form that its `dense` asks for."""
    kind = "dense_trajectory" if root_path.dense else "keyframes"
    points = {str(frame): point for frame, point in zip(root_path.frames, root_path.points.tolist(), strict=True)}
    text = write_json({"type": kind, _FIELDS[kind]: points})
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")
