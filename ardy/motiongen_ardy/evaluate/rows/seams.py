"""Seams: jumps where windows and prompts meet, beside the captures' 99th percentile."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.evaluate.cases import MOVING
from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.figure import Bound, Sample, summarize
from motiongen_ardy.evaluate.measures.smooth import KINDS, seam_jumps
from motiongen_ardy.evaluate.rows.velocity import STAND, WALK, WAVE
from motiongen_ardy.evaluate.take import Result, Take

FAMILY = "seam"
UNITS = ("m", "m/s", "m/s2")
RUN = "a person runs forward"
PROMPTS = (WALK, STAND, WAVE, WALK, RUN)


def add(context: Context) -> None:
    """Add rows for the seams of windows under one prompt, and for those where the prompt changes."""
    seeds = range(context.size.sessions)
    steady = [Take(f"steady {text}", seed, context.frames(8), ((0, text),)) for seed in seeds for text in (WALK, RUN)]
    spans = tuple((context.frames(3) * number, text) for number, text in enumerate(PROMPTS))
    end = context.frames(3) * len(PROMPTS)
    mixed = [Take("mixed", seed, end, spans) for seed in seeds]
    results = context.run([*steady, *mixed])
    windows = [(result, result.window_starts) for result in results[: len(steady)]]
    changes = [(result, tuple(frame for frame, _ in spans)) for result in results[len(steady) :]]
    _jumps(context, "window seams", windows)
    _jumps(context, "prompt seams", changes)
    context.show(FAMILY, [Exhibit("walk, stand, wave, walk, run: 3 s each", results[-1])])


def _jumps(context: Context, name: str, seams: list[tuple[Result, tuple[int, ...]]]) -> None:
    """One row for each kind of jump; a sample is the 95th percentile over the seams of a take."""
    rows: list[tuple[str, Tensor]] = []
    for result, frames in seams:
        jumps = seam_jumps(result.positions, frames, context.fps)
        if len(jumps):
            rows.append((result.take.case, torch.quantile(jumps, 0.95, dim=0)))
    for number, (kind, unit) in enumerate(zip(KINDS, UNITS, strict=True)):
        samples = [Sample(case, float(jump[number])) for case, jump in rows]
        limit = float(context.captured.jumps[number])
        bound = Bound(most=float(f"{limit:.3g}"))
        key = (FAMILY, f"{name}: jump of {kind}, p95", MOVING)
        context.add(summarize(key, unit, samples, bound=bound, data=limit))
