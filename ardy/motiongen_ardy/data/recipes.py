"""Derived clips of every kind: how many hours of each, which are good enough, their names and captions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import torch

from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.data.captions import mirror_content, paraphrases
from motiongen_ardy.data.dataset import Clip, Segment
from motiongen_ardy.data.poses import global_pose
from motiongen_ardy.data.quality import Quality, quality
from motiongen_ardy.data.shelf import Made, Shelf, Unfit, moving_content
from motiongen_ardy.data.standing_recipes import start_or_stop, transition
from motiongen_ardy.data.validation import SEPARATOR
from motiongen_ardy.data.way_recipes import bend, on_the_spot, speed_change, strafe

# Each recipe, and its hours in a whole set.
RECIPES: dict[str, tuple[Callable[[Shelf], Made], float]] = {
    "start-stop": (start_or_stop, 1.15),
    "transition": (transition, 0.7),
    "bend": (bend, 1.3),
    "strafe": (strafe, 0.5),
    "on-the-spot": (on_the_spot, 0.3),
    "speed": (speed_change, 0.45),
}
# In sideways steps, feet must not cross by more than this, metres.
MAX_CROSSING_M = 0.08


def fault(made: Made, figures: Quality, skeleton: Skeleton) -> str:
    """What distinguishes a clip from captures; "" if nothing does. Bounds: the captures' 95th to 99th percentiles."""
    running = any(moving_content(source) == "run" for source in made.sources)
    bounds = {
        "acceleration": (figures.acceleration, 90.0 if running else 66.0),
        "skate_m_s": (figures.skate_m_s, 0.14 if running else 0.1),
        "slowest_ratio": (figures.slowest_ratio, 0.3 if running else 0.08),
        "knee_deg": (figures.knee_deg, 46.0 if running else 33.0),
        "lifted_m": (figures.lifted_m, 0.16 if running else 0.05),
        "drop_m": (float(made.motion.drop_m.max()), 0.11),
        "short_m": (float(made.motion.short_m.max()), 0.02),
    }
    if made.kind == "strafe":
        bounds["crossing_m"] = (crossing(made, skeleton), MAX_CROSSING_M)
    return next((name for name, (value, bound) in bounds.items() if not value <= bound), "")


def crossing(made: Made, skeleton: Skeleton) -> float:
    """How far the left ankle gets to the right of the right one, in metres, across the hips."""
    poses = made.motion.poses
    _, positions = global_pose(skeleton, poses.quaternions, poses.root)
    right, left = skeleton.hip_joints
    across = positions[:, left] - positions[:, right]
    across[:, 1] = 0
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    apart = positions[:, skeleton.left_foot[0]] - positions[:, skeleton.right_foot[0]]
    return float(-(apart * across).sum(-1).min())


@lru_cache
def _captions(content: str, style: str) -> tuple[str, ...]:
    return paraphrases(content, style) or paraphrases(content, "none")


def clip_of(made: Made, figures: Quality, number: int) -> Clip:
    """The finished clip. Its own captions describe the sequence; each segment's captions describe its frames.

    Raises Unfit if a label has no phrases, which can happen with labels of other tables.
    """
    frames = made.motion.poses.num_frames
    edges = [min(max(span[0], 0), frames) for span in made.spans] + [frames]
    parts = [
        Segment(edges[k], edges[k + 1] - edges[k], content, _captions(content, style))
        for k, (_, content, style) in enumerate(made.spans)
        if edges[k + 1] > edges[k]
    ]
    if not all(part.captions for part in parts):
        raise Unfit("no phrases")
    whole = parts[0].captions
    if len(parts) > 1:
        whole = tuple(
            " and then ".join(
                [parts[0].captions[0 if k == 0 else 2 * k % len(parts[0].captions)]]
                + [part.captions[2 * k % len(part.captions)].removeprefix("a person ") for part in parts[1:]]
            )
            for k in range(4)
        )
    first = made.sources[0]
    flags = {flag for source in made.sources for flag in source.flags} - {"cut"}
    turned = mirror_content(made.content) != made.content
    allowed = all(source.mirror_allowed for source in made.sources) and not (turned and first.style == "exhausted")
    return Clip(
        id=f"{first.id}~{made.kind}{number}",
        dataset=first.dataset,
        content=made.content,
        style=made.style,
        split=first.split,
        captions=tuple(dict.fromkeys(whole)),
        segments=tuple(parts) if len(parts) > 1 else (),
        mirror_allowed=allowed,
        derived_from=SEPARATOR.join(dict.fromkeys(source.id for source in made.sources)),
        flags=tuple(sorted(flags | {f"derived-{made.kind}"})),
        figures=figures.rounded(),
        local_rotations=torch.from_numpy(made.motion.poses.quaternions).float(),
        root_positions=torch.from_numpy(made.motion.poses.root).float(),
    )


def make(
    clips: Sequence[Clip], skeleton: Skeleton, fps: float, seed: int, share: float
) -> tuple[list[Clip], dict[str, int]]:
    """Clips derived from one split's captures, `share` of the hours of RECIPES; and counts of dropped ones, by reason.

    The same captures, seed and share give the same clips.
    """
    made_clips: list[Clip] = []
    dropped: dict[str, int] = {}
    for place, (name, (recipe, hours)) in enumerate(RECIPES.items()):
        shelf = Shelf(skeleton, fps, clips, np.random.default_rng([seed, place]))
        budget, frames, tries = hours * share * 3600 * fps, 0, 0
        while frames < budget and tries < 60 + budget / 30:
            tries += 1
            try:
                made = recipe(shelf)
                poses = made.motion.poses
                if poses.num_frames < 30:
                    raise Unfit("too short")
                figures = quality(skeleton, poses.quaternions, poses.root, fps)
                if reason := fault(made, figures, skeleton):
                    raise Unfit(reason)
                made_clips.append(clip_of(made, figures, tries))
            except Unfit as error:
                reason = f"{name}: {error}"
                dropped[reason] = dropped.get(reason, 0) + 1
                continue
            frames += poses.num_frames
    return made_clips, dropped
