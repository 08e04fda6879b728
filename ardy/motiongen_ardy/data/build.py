"""Builds a training set from a folder of BVH files and a labels table."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path

import torch
from torch import Tensor

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics
from motiongen_ardy.data.bvh import BvhError, read_bvh
from motiongen_ardy.data.captions import mirror_content, paraphrases
from motiongen_ardy.data.dataset import Clip, MotionDataset, Segment
from motiongen_ardy.data.derive import derived_spans, standing_clips, turning_spans
from motiongen_ardy.data.labels import Label, read_labels
from motiongen_ardy.data.recipes import make
from motiongen_ardy.data.retarget import RetargetedClip, apply_retarget, choose_retarget
from motiongen_ardy.data.retarget_rules import Retarget, RetargetError
from motiongen_ardy.data.validation import CUT_MARK

# No captured joint moves faster than this; a file with a faster one contains a jump.
MAX_JOINT_SPEED_M_S = 25.0
# Farther from the origin, a set's float32 positions are a millimetre or more apart, and finally useless.
MAX_DISTANCE_M = 10_000.0
# A foot is planted while its joints move more slowly than this in the source.
PLANTED_M_S = 0.03
# A clip with this flag is cut into pieces no longer than this.
CUT_FLAG = "cut"
MAX_CUT_S = 20.0
# With this many hours of captured walking, all derived hours of the recipes are made; with less, a proportional part.
FULL_WALKING_H = 0.3


class SkippedClip(ValueError):
    """Raised for a clip that is left out. The message is the reason."""


@dataclass(frozen=True)
class BuildSettings:
    """How to build a set. skip_flags: clips with one of these flags in the table are left out."""

    folder: Path
    skeleton: Skeleton
    retargets: tuple[Retarget, ...]
    fps: float = 20.0
    skip_flags: frozenset[str] = frozenset({"label_suspect", "fragment"})
    min_seconds: float = 0.5
    derive_standing: bool = True
    derive_moving: bool = True
    seed: int = 7


@dataclass
class BuildResult:
    """Clips in the order of the table, then derived ones; skipped: what was left out, as (clip id, reason).

    dropped: how many derived clips were not good enough, by kind and reason.
    """

    clips: list[Clip] = field(default_factory=list)
    skipped: list[tuple[str, str]] = field(default_factory=list)
    dropped: dict[str, int] = field(default_factory=dict)

    def dataset(self, settings: BuildSettings) -> MotionDataset:
        return MotionDataset(settings.skeleton, settings.fps, tuple(self.clips))


def more_labels(folder: Path) -> tuple[Label, ...]:
    """The labels, included in the package, of known captures that come without a table, for files in the folder."""
    with resources.as_file(resources.files("motiongen_ardy") / "data" / "more_labels.csv") as path:
        return tuple(label for label in read_labels(path) if (folder / label.file).is_file())


def build(labels: Iterable[Label], settings: BuildSettings, advance: Callable[[], None] = lambda: None) -> BuildResult:
    """Convert every clip of the table. A clip that cannot be used is recorded with its reason, and the others continue.

    advance is called after each row of the table.
    """
    labels = tuple(labels)
    unseen = frozenset((row.dataset, row.content, row.style) for row in labels if row.split == "test_unseen")
    result = BuildResult()
    for label in labels:
        try:
            result.clips += build_clip(label, settings, unseen)
        except (SkippedClip, BvhError, RetargetError, OSError) as error:
            result.skipped.append((label.id, str(error)))
        advance()
    if settings.derive_moving and settings.skeleton.name == "core27":
        _derive(result, settings)
    return result


def _derive(result: BuildResult, settings: BuildSettings) -> None:
    """Add starts, stops, changes, bends and so on, in proportion to the walking in each split."""
    for place, split in enumerate(("train", "test")):
        clips = [clip for clip in result.clips if clip.split == split]
        walking = sum(clip.num_frames for clip in clips if clip.content == "walk") / settings.fps / 3600
        share = min(1.0, walking / (FULL_WALKING_H if split == "train" else 4 * FULL_WALKING_H))
        made, dropped = make(clips, settings.skeleton, settings.fps, settings.seed + place, share)
        result.clips += made
        for reason, count in dropped.items():
            result.dropped[f"{split}, {reason}"] = count


def build_clip(label: Label, settings: BuildSettings, unseen: frozenset[tuple[str, str, str]]) -> list[Clip]:
    """The clip of one row and the clips derived from it. unseen: (dataset, content, style) reserved for the test.

    Raises SkippedClip, BvhError, RetargetError or OSError.
    """
    flagged = sorted(label.flags & settings.skip_flags)
    if flagged:
        raise SkippedClip(f"flagged {', '.join(flagged)} in the labels table")
    bvh = read_bvh(settings.folder / label.file)
    retarget = choose_retarget(bvh, settings.retargets)
    motion = apply_retarget(retarget, bvh, settings.fps, label.rest_group)
    rotations = quaternion_to_matrix(motion.local_rotations)
    _, positions = forward_kinematics(settings.skeleton, rotations, motion.root_positions)
    _check_motion(positions, settings)
    mirror_allowed = (
        label.split == "train" and (label.dataset, mirror_content(label.content), label.style) not in unseen
    )
    segments = tuple(
        Segment(span.start, span.length, span.content, paraphrases(span.content, label.style))
        for span in (
            *derived_spans(settings.skeleton, label.content, positions, settings.fps),
            *turning_spans(settings.skeleton, label.content, positions, settings.fps),
        )
        if paraphrases(span.content, label.style)
    )
    clip = Clip(
        id=label.id,
        dataset=label.dataset,
        content=label.content,
        style=label.style,
        split=label.split,
        captions=tuple(dict.fromkeys(label.texts + paraphrases(label.content, label.style))),
        segments=segments,
        mirror_allowed=mirror_allowed,
        derived_from="",
        flags=tuple(sorted(label.flags)),
        figures=_figures(settings.skeleton, retarget, motion, positions, settings.fps),
        local_rotations=motion.local_rotations.to(torch.float32),
        root_positions=motion.root_positions.to(torch.float32),
    )
    if CUT_FLAG in label.flags:
        return list(cut(clip, round(MAX_CUT_S * settings.fps)))
    return [clip, *(_standing(clip, settings) if settings.derive_standing else ())]


def cut(clip: Clip, max_frames: int) -> Iterable[Clip]:
    """Cut a long clip without segments into equal pieces of at most max_frames, named ~cut1, ~cut2 and so on."""
    count = -(-clip.num_frames // max_frames)
    edges = [clip.num_frames * number // count for number in range(count + 1)]
    for number, (start, end) in enumerate(itertools.pairwise(edges), start=1):
        yield replace(
            clip,
            id=f"{clip.id}{CUT_MARK}{number}",
            segments=(),
            local_rotations=clip.local_rotations[start:end],
            root_positions=clip.root_positions[start:end],
        )


def _standing(clip: Clip, settings: BuildSettings) -> list[Clip]:
    """Clips of standing made from a gesture clip; none from combinations that are reserved for the test."""
    captions = paraphrases("stand", clip.style)
    if clip.split == "test_unseen" or not captions:
        return []
    stretches = standing_clips(settings.skeleton, clip.content, clip.local_rotations, clip.root_positions, settings.fps)
    return [
        Clip(
            id=f"{clip.id}~stand{number}",
            dataset=clip.dataset,
            content="stand",
            style=clip.style,
            split=clip.split,
            captions=captions,
            segments=(),
            mirror_allowed=clip.mirror_allowed,
            derived_from=clip.id,
            flags=clip.flags,
            figures={},
            local_rotations=rotations,
            root_positions=positions,
        )
        for number, (rotations, positions) in enumerate(stretches, start=1)
    ]


def _check_motion(positions: Tensor, settings: BuildSettings) -> None:
    num_frames = positions.shape[0]
    if num_frames < max(2, settings.min_seconds * settings.fps):
        raise SkippedClip(
            f"only {num_frames} frames at {settings.fps:g} fps; at least {settings.min_seconds:g} s are needed"
        )
    if not bool(torch.isfinite(positions).all()):
        raise SkippedClip("positions that are not finite")
    furthest = float(positions.abs().max())
    if furthest > MAX_DISTANCE_M:
        raise SkippedClip(
            f"it lies {furthest:.3g} m from the origin, more than {MAX_DISTANCE_M:g} m, where a set is too coarse for"
            " motion; move it, or mend metres_per_unit of its retarget"
        )
    speed = (positions[1:] - positions[:-1]).norm(dim=-1) * settings.fps
    fastest = float(speed.max())
    if fastest > MAX_JOINT_SPEED_M_S:
        frame, joint = divmod(int(speed.argmax()), speed.shape[1])
        raise SkippedClip(
            f"joint {settings.skeleton.joint_names[joint]} jumps at {fastest:.0f} m/s after frame {frame}"
            f" ({settings.fps:g} fps); at most {MAX_JOINT_SPEED_M_S:g} m/s is believed"
        )


def _figures(
    skeleton: Skeleton, retarget: Retarget, motion: RetargetedClip, positions: Tensor, fps: float
) -> dict[str, float]:
    """How fast our ankles and toes drift while the source's stand: median horizontal m/s over planted frames."""
    if not retarget.feet:
        return {}
    ours = positions[:, [skeleton.index(target) for _, target in retarget.feet]]
    source = motion.source_feet_m
    source_speed = (source[1:] - source[:-1]).norm(dim=-1) * fps  # (T - 1, F)
    drift = (ours[1:] - ours[:-1])[..., [0, 2]].norm(dim=-1) * fps
    heels = drift[:, 0::2]
    planted = (source_speed[:, 0::2] < PLANTED_M_S) & (source_speed[:, 1::2] < PLANTED_M_S)
    if not bool(planted.any()):
        return {}
    return {
        "planted_frames": int(planted.sum()),
        "planted_drift_m_s": round(float(heels[planted].median()), 5),
        "planted_height_m": round(float(ours[1:, 0::2, 1][planted].median()), 5),
    }
