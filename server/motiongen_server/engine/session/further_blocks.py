"""Further blocks: those that a session asked to have in its frame rows besides the rig's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import Chunk, Float32Array

MakeOutputs: TypeAlias = Callable[[Sequence[str], Float32Array], Float32Array | None]
"""As `Runner.outputs`; None if the model fails."""


class OutputsFailed(RuntimeError):
    """The blocks that a session asked for cannot be made of its frames. The message is for its client."""


def with_outputs(chunk: Chunk, names: Sequence[str], timeline: Timeline, make: MakeOutputs) -> Chunk:
    """The chunk with the blocks appended to its rows. timeline: holds its frames. Raises OutputsFailed.

    Velocities at a frame are relative to the frame before it, so that a chunk depends only on frames that are decided.
    The first frame has none before it, nor has the first after a cut.
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
