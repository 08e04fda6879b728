"""Where a window ends: a goal close behind its end could not be prepared for, so it gets more of the next window.

What a goal takes to be met is spread over the frames before it. Frames of an earlier window do not change any more, and
do not know the pose that the model would have at the goal; so a window is kept only up to a frame from which the next
one has room for its goals.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.sampling.options import SamplingOptions


def frames_to_keep(targets: Targets | None, first_frame: int, horizon: int, options: SamplingOptions) -> int:
    """How many of a window's `horizon` frames from first_frame on count: all, or fewer where that gives goals room.

    targets: as they were asked for, not what is planned to lead there. Of the ends in question, the one whose goals
    behind it leave the most room counts: the tightest kind of goal first, then the next, then the later end. A
    kind that has a goal at every frame is as tight at every end, and does not count.
    """
    approach = min(options.approach_frames, horizon // 2)
    if targets is None or not approach or not (options.plan_root or options.reach_joints):
        return horizon
    end = first_frame + horizon
    kinds = _asked_frames(targets, range(end - approach, end + approach))
    if not any(frame >= end for frames in kinds.values() for frame in frames):
        return horizon

    def room(kept: int) -> list[int]:
        from_frame = first_frame + kept
        behind = ([frame - from_frame for frame in frames if frame >= from_frame] for frames in kinds.values())
        return sorted(min([*each, approach]) for each in behind)

    return max(range(horizon - approach, horizon + 1), key=lambda kept: (room(kept), kept))


def _asked_frames(targets: Targets, span: range) -> dict[Hashable, set[int]]:
    """The frames of a span at which each kind of goal asks for something, by kind; nobody asked for planned ones.

    Kinds that ask at every frame of it are left out: every end is as tight for them.
    """
    kinds: dict[Hashable, set[int]] = {}

    def add(kind: Hashable, frames: Iterable[int]) -> None:
        if inside := {frame for frame in frames if frame in span}:
            kinds.setdefault(kind, set()).update(inside)

    add("ground", targets.ground.keys() - targets.planned)
    add("heading", targets.heading.keys() - targets.faced)
    add("height", targets.height)
    for frame, joint in (*targets.positions, *targets.rotations):
        add(joint, (frame,))
    return {kind: frames for kind, frames in kinds.items() if len(frames) < len(span)}
