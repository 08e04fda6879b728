"""The training set on disk: ``motion.npz`` with all frames end to end, and ``clips.json`` with everything else.

motion.npz holds `local_rotations` (N, J, 4) float32, parent-relative, (w, x, y, z), and `root_positions` (N, 3)
float32, metres; N is the number of frames of all clips. clips.json gives each clip's first frame and length in these
arrays. World positions and headings are those of the capture; a training loader turns and recentres windows itself.
"""

from __future__ import annotations

import json
import tempfile
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.core.skeleton import Skeleton, load_skeleton
from motiongen_ardy.data.captions import mirror_caption, mirror_content
from motiongen_ardy.data.mirror import mirror_clip
from motiongen_ardy.data.set_rows import TOP_FIELDS, fields_problem, rate_problem, rows_problem
from motiongen_ardy.data.validation import with_validation

FORMAT = 1
MOTION_FILE = "motion.npz"
CLIPS_FILE = "clips.json"


class DatasetError(ValueError):
    """Raised for a folder that is not a training set, or not one of this format."""


@dataclass(frozen=True)
class Segment:
    """Frames start .. start + length - 1 of a clip, with captions narrower than the clip's own."""

    start: int
    length: int
    content: str
    captions: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Clip:
    """One motion. local_rotations: (T, J, 4) as (w, x, y, z); root_positions: (T, 3) metres.

    mirror_allowed: whether the mirror image may be trained on; not if its labels are reserved for the test.
    derived_from: the ids of the clips from which this one was made, joined by "+"; "" for a captured clip.
    figures: numbers recorded while building, for example how far planted feet drift.
    """

    id: str
    dataset: str
    content: str
    style: str
    split: str
    captions: tuple[str, ...]
    segments: tuple[Segment, ...]
    mirror_allowed: bool
    derived_from: str
    flags: tuple[str, ...]
    figures: Mapping[str, float]
    local_rotations: Tensor
    root_positions: Tensor

    @property
    def num_frames(self) -> int:
        return int(self.root_positions.shape[0])

    def mirrored(self, skeleton: Skeleton) -> Clip:
        """The mirror image, with left and right swapped in labels and captions."""
        rotations, positions = mirror_clip(skeleton, self.local_rotations, self.root_positions)
        segments = tuple(
            Segment(part.start, part.length, mirror_content(part.content), tuple(map(mirror_caption, part.captions)))
            for part in self.segments
        )
        return replace(
            self,
            content=mirror_content(self.content),
            captions=tuple(map(mirror_caption, self.captions)),
            segments=segments,
            local_rotations=rotations,
            root_positions=positions,
        )


@dataclass(frozen=True, eq=False)
class MotionDataset:
    """Clips with one skeleton and frame rate."""

    skeleton: Skeleton
    fps: float
    clips: tuple[Clip, ...]

    @property
    def num_frames(self) -> int:
        return sum(clip.num_frames for clip in self.clips)

    def require(self, skeleton: str, fps: int) -> None:
        """Raise DatasetError unless the set has a model's skeleton and frame rate, as evaluation requires."""
        if (self.skeleton.name, self.fps) != (skeleton, fps):
            raise DatasetError(
                f"the set is of {self.skeleton.name} at {self.fps:g} frames a second, the model of {skeleton} at {fps};"
                f" build it with --skeleton {skeleton} --fps {fps}"
            )

    @classmethod
    def load(cls, folder: Path, split: str | None = None) -> MotionDataset:
        """Read a set, or one split of it ("train", "validation", "test", "test_unseen"). Raises DatasetError.

        "validation" is a fixed part of the clips that the table calls "train"; see `validation.py`. The clips are views
        of two shared tensors: do not write to them.
        """
        document = _read_document(folder)
        try:
            # numpy does not close a file that it cannot read.
            with (folder / MOTION_FILE).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                rotations, positions = (_finite(arrays, name) for name in ("local_rotations", "root_positions"))
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise DatasetError(f"{folder / MOTION_FILE}: cannot be read: {error}; build the set again") from error
        rows = document["clips"]
        if problem := rows_problem(rows):
            raise DatasetError(f"{folder / CLIPS_FILE}: {problem}; mend it, or build the set again")
        skeleton = load_skeleton(document["skeleton"])
        total = sum(row["length"] for row in rows)
        if rotations.shape != (total, skeleton.num_joints, 4) or positions.shape != (total, 3):
            raise DatasetError(
                f"{folder}: {CLIPS_FILE} promises {total} frames of {skeleton.num_joints} joints, {MOTION_FILE} has"
                f" {tuple(rotations.shape)} rotations and {tuple(positions.shape)} positions; build the set again"
            )
        by_id = with_validation(
            {row["id"]: row["split"] for row in rows}, {row["id"]: row["derived_from"] for row in rows}
        )
        splits = sorted(set(by_id.values()))
        if split is not None and split not in splits:
            raise DatasetError(f"{folder}: no split {split!r}; this set has {', '.join(splits)}")
        clips = tuple(_clip(row, rotations, positions) for row in rows if split in (None, by_id[row["id"]]))
        return cls(skeleton, float(document["fps"]), clips)

    def save(self, folder: Path, skipped: Sequence[tuple[str, str]] = (), notes: str = "") -> None:
        """Write the set to a folder, which is created if necessary. skipped: (clip id, reason) pairs, for the record.

        An existing set is replaced only once the new one is written completely. Raises DatasetError if it cannot be
        written.
        """
        prepare_folder(folder)
        rows: list[dict[str, Any]] = []
        start = 0
        for clip in self.clips:
            rows.append(_row(clip, start))
            start += clip.num_frames
        document = {
            "format": FORMAT,
            "skeleton": self.skeleton.name,
            "fps": self.fps,
            "notes": notes,
            "skipped": [{"id": id_, "reason": reason} for id_, reason in skipped],
            "clips": rows,
        }
        try:
            # Both files are written before either is renamed: a full disk cannot combine the motion and clips of
            # different sets.
            with written_whole(folder / CLIPS_FILE) as clips, written_whole(folder / MOTION_FILE) as motion:
                clips.write_text(json.dumps(document, indent=1), encoding="utf-8")
                with motion.open("wb") as file:
                    np.savez(
                        file,
                        local_rotations=_end_to_end([clip.local_rotations for clip in self.clips]),
                        root_positions=_end_to_end([clip.root_positions for clip in self.clips]),
                    )
        except OSError as error:
            raise DatasetError(f"{folder}: the set cannot be written: {error}; what was there is as it was") from error


def prepare_folder(folder: Path) -> None:
    """Create the folder of a set, and check that files can be written there. Raises DatasetError if not."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise DatasetError(f"{folder}: no set can be written there: {error}; name another folder") from error


def skipped_clips(folder: Path) -> list[tuple[str, str]]:
    """The clips that were left out when the set was built: (id, reason). Raises DatasetError."""
    return [(entry["id"], entry["reason"]) for entry in _read_document(folder)["skipped"]]


def _read_document(folder: Path) -> dict[str, Any]:
    path = folder / CLIPS_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise DatasetError(
            f"{folder}: no {CLIPS_FILE}; make a set with `python -m motiongen_ardy.data build`"
        ) from error
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise DatasetError(f"{path}: not a training set of format {FORMAT}; build it again")
    if problem := fields_problem(document, TOP_FIELDS) or rate_problem(document["fps"]):
        raise DatasetError(f"{path}: {problem}; mend it, or build the set again")
    return document


def _finite(arrays: Mapping[str, np.ndarray], name: str) -> Tensor:
    """An array of a set in float32. Raises ValueError unless it holds finite floats, KeyError if it is missing."""
    array = arrays[name]
    if array.dtype.kind != "f" or not np.isfinite(array).all():
        raise ValueError(f"{name} holds {array.dtype}, or NaN or infinite numbers; every one must be a finite float")
    return torch.from_numpy(np.ascontiguousarray(array, np.float32))


def _end_to_end(parts: Sequence[Tensor]) -> np.ndarray:
    array: np.ndarray = torch.cat(list(parts)).to(torch.float32).numpy()
    return array


def _row(clip: Clip, start: int) -> dict[str, Any]:
    return {
        "id": clip.id,
        "dataset": clip.dataset,
        "content": clip.content,
        "style": clip.style,
        "split": clip.split,
        "start": start,
        "length": clip.num_frames,
        "captions": clip.captions,
        "segments": [
            {"start": part.start, "length": part.length, "content": part.content, "captions": part.captions}
            for part in clip.segments
        ],
        "mirror_allowed": clip.mirror_allowed,
        "derived_from": clip.derived_from,
        "flags": clip.flags,
        "figures": dict(clip.figures),
    }


def _clip(row: dict[str, Any], rotations: Tensor, positions: Tensor) -> Clip:
    frames = slice(row["start"], row["start"] + row["length"])
    return Clip(
        id=row["id"],
        dataset=row["dataset"],
        content=row["content"],
        style=row["style"],
        split=row["split"],
        captions=tuple(row["captions"]),
        segments=tuple(
            Segment(part["start"], part["length"], part["content"], tuple(part["captions"])) for part in row["segments"]
        ),
        mirror_allowed=row["mirror_allowed"],
        derived_from=row["derived_from"],
        flags=tuple(row["flags"]),
        figures=row["figures"],
        local_rotations=rotations[frames],
        root_positions=positions[frames],
    )
