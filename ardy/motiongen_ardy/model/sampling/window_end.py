"""Where a window ends: it is cut short if a goal soon after its end would otherwise come as a surprise.

The correction that a goal needs is spread over the frames before it. Frames of an earlier window can no longer change,
and were made without knowledge of the pose at the goal; so a window is kept only up to a frame from which the next
one has enough room for its goals.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.sampling.options import SamplingOptions


def frames_to_keep(targets: Targets | None, first_frame: int, horizon: int, options: SamplingOptions) -> int:
    """How many of a window's `horizon` frames from first_frame on are kept: all, or fewer to give goals more room.

    targets: as asked for, without what is planned. Of the possible ends, the one that leaves the most room to the goals
    behind it is chosen: compared by the tightest kind of goal first, then by the next, then in favour of the later end.
    A kind with a goal at every frame is ignored, since it is equally tight at every end.
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
    """For each kind of goal, the frames of a span at which it was asked for (planned frames do not count).

    Kinds with a goal at every frame are left out: every end is equally tight for them.
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
