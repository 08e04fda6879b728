"""How many windows begin together where more are asked for again and again than one step can answer soon."""

from __future__ import annotations

from math import ceil

from motiongen_server.engine.scheduling.costs import CostTable


def begin_together(costs: CostTable, num_windows: int, passes: int, num_steps: int) -> int:
    """Of so many windows that change frames, those that begin now; the others begin when these are done.

    passes: evaluations of a step that one costs. Each is asked for again before all are done, as by a stick. In k parts
    of W seconds each, one after another, an edit waits for its turn, up to k W, and then for W: (k / 2 + 1) W on
    average and (k + 1) W at worst. The sum of both is made least.
    """

    def wait_s(groups: int) -> float:
        size = ceil(num_windows / groups)
        window_s = costs.prepare.seconds(size) + num_steps * costs.step.seconds(size * passes)
        return (1.5 * groups + 2.0) * (window_s + costs.decode.seconds(size))

    return ceil(num_windows / min(range(1, num_windows + 1), key=wait_s)) if num_windows > 1 else num_windows
