"""Lifts: how far feet and hips are lifted, frame by frame, to adapt level motion to uneven ground. Pure."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

STEP_M = 0.04
"""If the ground under a standing foot rises by more than this from one frame to the next, it is a step, not a slope."""
_TAPER = 1


def runs(flags: Bool) -> list[tuple[int, int]]:
    """The runs of true values in flags (T,), each as (first, one past the last)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def standing_lift(heights: Float64, planted: Bool) -> Float64:
    """(T,) the ground's height under a point of a foot while the foot stands, 0 elsewhere.

    heights, planted: (T,). A foot on the edge of a step has the upper height for as long as it stands.
    """
    lift = np.where(planted, heights, 0.0)
    for begin, end in runs(planted):
        if end - begin > 1 and np.abs(np.diff(heights[begin:end])).max() > STEP_M:
            lift[begin:end] = heights[begin:end].max()
    return lift


def swing_lift(lift: Float64, heights: Float64, planted: Bool, clearance: Float64) -> Float64:
    """`standing_lift` with the lift of a foot in the air added: from where it stood to where it will stand.

    heights, clearance: (T,) the ground's height under the foot, and the foot's height above the level floor; it is
    lifted more where it would pass through the ground. Before the first and after the last stand, the lift starts from
    or ends at the ground below it.
    """
    whole, num_frames = lift.copy(), len(lift)
    stands = runs(planted)
    ends = [(-1, 0), *stands, (num_frames, num_frames + 1)]
    for (_, begin), (end, _) in pairwise(ends):
        if begin >= end:
            continue
        before = lift[begin - 1] if begin > 0 else (lift[end] if end < num_frames else heights[0])
        after = lift[end] if end < num_frames else heights[-1]
        share = (np.arange(begin, end) - begin + 1) / (end - begin + 1)
        whole[begin:end] = before + (after - before) * share * share * (3 - 2 * share)
        count = end - begin
        missing = np.maximum(heights[begin:end] - clearance[begin:end] - whole[begin:end], 0.0)
        from_stand = np.arange(1, count + 1) if begin > 0 else np.full(count, count)
        to_stand = np.arange(count, 0, -1) if end < num_frames else np.full(count, count)
        taper = np.minimum(np.minimum(from_stand, to_stand) / (_TAPER + 1), 1.0)
        whole[begin:end] += covering(missing, 2) * taper
    return whole


def covering(values: Float64, reach: int) -> Float64:
    """(T,) smooth and nowhere below `values` (T,): the moving mean of the moving maximum, `reach` frames each side."""
    return averaged(_greatest(values, reach), reach)


def averaged(values: Float64, reach: int) -> Float64:
    """(T,) the moving mean over `reach` frames to each side; the first and last values are repeated beyond the ends."""
    padded = np.pad(values, reach, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).mean(axis=-1), np.float64)


def _greatest(values: Float64, reach: int) -> Float64:
    padded = np.pad(values, reach, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=-1), np.float64)
