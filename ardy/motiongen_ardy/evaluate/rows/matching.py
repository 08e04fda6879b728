"""Text against motion, by the judge: R-precision and FID of takes from captions of held-out clips."""

from __future__ import annotations

import numpy as np
import torch

from motiongen_ardy.evaluate.cases import MOVING, STANDING, Case
from motiongen_ardy.evaluate.context import Context
from motiongen_ardy.evaluate.figure import Bound, Sample, summarize
from motiongen_ardy.evaluate.judge import MAX_FRAMES
from motiongen_ardy.evaluate.measures.matching import frechet_distance, ranks
from motiongen_ardy.evaluate.take import Take

FAMILY = "text"
MIN_CASES = 2  # the fewest that have a spread


def add(context: Context) -> None:
    """Add R-precision top-1 to top-3 of the takes beside the captures', and both distances to other captures."""
    cases = [case for case in context.cases if not case.derived and case.num_frames >= 40]
    judge = context.judge
    assert judge is not None, "a command that names these rows has loaded it"
    told, others = cases[::2][: context.size.matched], cases[1::2]
    if min(len(told), len(others)) < MIN_CASES:
        context.unjudged.append(f"{FAMILY}: R-precision, of {len(cases)} captured clips of 40 frames")
        return
    texts = judge.texts(torch.cat([context.sampler.text(case.caption) for case in told]))
    labels = [case.label for case in told]
    captured = judge.embed(context.layout, [case.features for case in told])
    made = [
        judge.embed(context.layout, [result.features for result in context.run([_take(case, seed) for case in told])])
        for seed in context.seeds
    ]
    own = ranks(captured, texts.detach(), labels)
    places = [ranks(vectors, texts.detach(), labels) for vectors in made]
    for group in (MOVING, STANDING):
        rows = [row for row, case in enumerate(told) if case.group == group]
        if rows:
            _precision(context, group, own[rows], [one[rows] for one in places], [told[row].id for row in rows])
    reference = judge.embed(context.layout, [case.features for case in others])
    distances = [Sample("FID", frechet_distance(vectors, reference)) for vectors in made]
    data = frechet_distance(captured, reference)
    context.add(
        summarize((FAMILY, "FID to other captures, moving and standing together", MOVING), "", distances, data=data)
    )


def _take(case: Case, seed: int) -> Take:
    end = min(case.num_frames, MAX_FRAMES)
    return Take(case.id, seed, end, ((0, case.caption),), case.group)


def _precision(context: Context, group: str, own: np.ndarray, places: list[np.ndarray], ids: list[str]) -> None:
    for top in (1, 2, 3):
        data = float((own < top).mean())
        samples = [Sample(id_, float(place < top)) for seed in places for id_, place in zip(ids, seed, strict=True)]
        share = context.bound("R-precision", group)
        bound = Bound(least=round(share.least * data, 3)) if top == 3 and share is not None and share.least else None
        key = (FAMILY, f"R-precision top-{top} of 32", group)
        context.add(summarize(key, "share", samples, bound=bound, data=data, more_is_better=True))
