"""Long sessions of mixed prompts: one row per seed and figure, so that a single bad session is noticed."""

from __future__ import annotations

import numpy as np
import torch

from motiongen_ardy.evaluate.cases import MOVING
from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.figure import Sample, summarize
from motiongen_ardy.evaluate.measures.feet import foot_joints, glide_share
from motiongen_ardy.evaluate.measures.posture import frozen_share, lean, over_seconds
from motiongen_ardy.evaluate.take import Result, Take, result_frames

FAMILY = "session"
PROMPTS = (
    "a person walks forward",
    "a person stands still",
    "a person waves with the right hand",
    "a person runs forward",
    "a person turns left while walking",
    "a person turns right while walking",
    "a person walks backward",
    "a person raises both hands",
)


def add(context: Context) -> None:
    """Add glide, drift, lean and freeze of each session."""
    takes = [_take(context, seed) for seed in range(context.size.long_sessions)]
    minutes = context.size.long_s / 60
    captured = [case.motion.positions for case in context.cases if not case.derived]
    shares = [glide_share(context.skeleton, positions, context.fps) for positions in captured]
    glide_of_data = float(np.average(shares, weights=[len(one) for one in captured])) if captured else None
    for result in context.run(takes):
        name = f"{minutes:g} minutes, seed {result.take.seed}"
        figures = _figures(context, result)
        for row, (unit, value) in figures.items():
            glide = row == "glide share"
            bound = context.bound("glide share") if glide else None
            sample = [Sample(name, value)]
            data = glide_of_data if glide else None
            context.add(summarize((FAMILY, f"{name}: {row}", MOVING), unit, sample, bound=bound, data=data))
        context.show(FAMILY, [Exhibit(f"{name}: last 15 s", result_frames(result, -15 * context.fps))])


def _take(context: Context, seed: int) -> Take:
    """Prompts drawn by the seed, each for 4 to 8 s."""
    draw = np.random.default_rng(seed)
    spans: list[tuple[int, str]] = []
    frame, end = 0, context.frames(context.size.long_s)
    while frame < end:
        others = [text for text in PROMPTS if not spans or text != spans[-1][1]]
        spans.append((frame, others[int(draw.integers(len(others)))]))
        frame += int(draw.integers(context.frames(4), context.frames(8)))
    return Take(f"session {seed}", seed, end, tuple(spans))


def _figures(context: Context, result: Result) -> dict[str, tuple[str, float]]:
    skeleton, fps, positions = context.skeleton, context.fps, result.positions
    # Averages over a tenth of each session: sinking by a millimetre a minute for an hour shows in the last one.
    tenth = max(fps, len(positions) // 10)
    low = foot_joints(skeleton, positions)[..., 1].amin(dim=-1)
    moving = torch.cat([torch.arange(first, end) for first, end, text in _spans(result) if "stand" not in text])
    figures = {
        "glide share": ("", glide_share(skeleton, positions, fps)),
        "drift of the ground": ("m", float((low[-tenth:].mean() - low[:tenth].mean()).abs())),
    }
    if "Neck" in skeleton.joint_names:
        figures["lean, largest over 2 s"] = ("degrees", float(over_seconds(lean(skeleton, positions), fps, 2).max()))
    figures["frozen share under prompts that move"] = ("", frozen_share(positions[moving], fps))
    return figures


def _spans(result: Result) -> list[tuple[int, int, str]]:
    take = result.take
    firsts = [first for first, _ in take.prompts] + [take.num_frames]
    return [(first, end, text) for (first, text), end in zip(take.prompts, firsts[1:], strict=True)]
