"""Draws a few clips of a training set for inspection: a PNG with a strip of poses for each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics
from motiongen_ardy.data.dataset import Clip, DatasetError, MotionDataset

NUM_POSES = 12
_COLOURS = {"left": "tab:blue", "right": "tab:red", "middle": "0.2"}


def draw(dataset: MotionDataset, png: Path, wanted: Sequence[str] = (), max_rows: int = 12) -> int:
    """Draw clips to a PNG file and return how many. wanted: clip ids or contents; by default one of each content.

    Each row shows poses at even intervals, seen from the front of the first pose and spread apart, and the root's path
    from above. Left limbs are blue, right limbs red. Raises DatasetError if a wanted clip does not exist, or the file
    cannot be written.
    """
    clips = _choose(dataset, wanted)[:max_rows]
    figure, axes = plt.subplots(
        len(clips), 2, figsize=(16, 1.9 * len(clips)), width_ratios=(6, 1), squeeze=False, layout="constrained"
    )
    for (strip, path), clip in zip(axes, clips, strict=True):
        _draw_clip(strip, path, clip, dataset.skeleton, dataset.fps)
    try:
        png.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(png, dpi=80)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{png}: cannot be written: {error}") from error
    finally:
        plt.close(figure)
    return len(clips)


def _choose(dataset: MotionDataset, wanted: Sequence[str]) -> list[Clip]:
    if not wanted:
        first: dict[str, Clip] = {}
        for clip in dataset.clips:
            first.setdefault(clip.content, clip)
        return list(first.values())
    chosen = []
    for name in wanted:
        found = next((clip for clip in dataset.clips if name in (clip.id, clip.content)), None)
        if found is None:
            contents = sorted({clip.content for clip in dataset.clips})
            raise DatasetError(f"no clip with the id or content {name!r}; contents are {', '.join(contents)}")
        chosen.append(found)
    return chosen


def _draw_clip(strip: plt.Axes, path: plt.Axes, clip: Clip, skeleton: Skeleton, fps: float) -> None:
    rotations = quaternion_to_matrix(clip.local_rotations.double())
    _, tensor = forward_kinematics(skeleton, rotations, clip.root_positions.double())
    positions = tensor.numpy()
    right, left = skeleton.hip_joints
    across = positions[0, left] - positions[0, right]
    across /= np.linalg.norm(across)
    frames = np.linspace(0, clip.num_frames - 1, NUM_POSES).round().astype(int)
    sides = [_side(skeleton.joint_names[joint]) for joint in range(1, skeleton.num_joints)]
    for place, frame in enumerate(frames):
        pose = positions[frame] - positions[frame, 0] * (1, 0, 1)
        # Seen from the front, so the left side is on the viewer's right; depth is shown by a slight tilt.
        depth = pose @ np.array([-across[2], 0, across[0]])
        flat = np.stack([pose @ across + 0.3 * depth + 1.6 * place, pose[:, 1] - 0.12 * depth], axis=-1)
        bones = [(flat[joint], flat[skeleton.parents[joint]]) for joint in range(1, skeleton.num_joints)]
        strip.add_collection(LineCollection(bones, colors=[_COLOURS[side] for side in sides], linewidths=1.5))
        strip.text(1.6 * place, -0.28, f"{frame / fps:.1f} s", ha="center", fontsize=7)
    strip.axhline(0, color="0.8", linewidth=0.8)
    strip.set(xlim=(-1, 1.6 * NUM_POSES - 0.6), ylim=(-0.35, 2.2), aspect="equal")
    # Without math parsing: two dollar signs in a caption are not a formula.
    strip.set_title(f"{clip.id}: {clip.captions[-1]}", fontsize=8, loc="left", parse_math=False)
    strip.axis("off")
    path.plot(positions[:, 0, 0], positions[:, 0, 2], color="0.2", linewidth=1)
    path.plot(*positions[0, 0, [0, 2]], "o", color="tab:green", markersize=4)
    path.set_aspect("equal", adjustable="datalim")
    path.invert_xaxis()  # from above with +Z up the page, +X is to the left
    path.tick_params(labelsize=6)


def _side(joint_name: str) -> str:
    return next((side for side in ("left", "right") if joint_name.lower().startswith(side)), "middle")
