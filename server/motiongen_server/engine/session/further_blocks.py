"""Further blocks: what a session asked to have in its frame rows besides those of the rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import Chunk, Float32Array

MakeOutputs: TypeAlias = Callable[[Sequence[str], Float32Array], Float32Array | None]
"""As `Runner.outputs`; None where the model can make none of them."""


class OutputsFailed(RuntimeError):
    """What a session asked for cannot be made of its frames. The message is for its client."""


def with_outputs(chunk: Chunk, names: Sequence[str], timeline: Timeline, make: MakeOutputs) -> Chunk:
    """The chunk with the blocks behind its rows. timeline: holds its frames. Raises OutputsFailed.

    Speeds of a frame are from the one before it, so that a chunk needs nothing that is not decided. The first frame
    has none, nor the first after a cut.
    """
    end = chunk.first_frame + len(chunk.rows)
    cuts = timeline.cuts
    edges = [chunk.first_frame, *(cut for cut in cuts if chunk.first_frame < cut < end), end]
    made = []
    for begin, stop in pairwise(edges):
        goes_on = begin > timeline.first and begin not in cuts
        rows = timeline.rows_between(begin - goes_on, stop)
        blocks = make(names, rows if goes_on else np.concatenate((rows[:1], rows)))
        if blocks is None:
            raise OutputsFailed(f"{', '.join(names)} could not be made of this session's frames; open a new session")
        made.append(blocks)
    return replace(chunk, rows=np.concatenate((chunk.rows, np.concatenate(made)), axis=1))
