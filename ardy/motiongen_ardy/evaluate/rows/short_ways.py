"""Short ways: a standing character takes a step or two and stands again; feet that jump to their place show here."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.measures.smooth import hardest_beside_root
from motiongen_ardy.evaluate.rows.velocity import STAND
from motiongen_ardy.evaluate.rows.waypoints import miss
from motiongen_ardy.evaluate.take import Result, Take, direction, result_frames

FAMILY = "short"
LEAD_S, WAY_S, AFTER_S = 2.0, 1.2, 1.5
CAPTURED_M_S2 = 80.0
"""The greatest acceleration of any joint in sixteen held-out captured walks; their median is 46."""
WAYS_M = {"0.6 m ahead": (0.6, 30), "0.5 m aside": (0.5, 90), "0.4 m behind": (0.4, 180)}


def add(context: Context) -> None:
    """Add all rows about short ways: sessions of standing characters that are given a place and nothing else."""
    lead = context.frames(LEAD_S)
    for row, (far, degrees) in WAYS_M.items():
        place = far * direction(math.radians(degrees))
        results = context.run([_take(context, row, seed, place) for seed in range(2 * context.size.sessions)])

        def hardest(result: Result) -> float:
            return hardest_beside_root(result.positions[lead:], context.fps)

        def is_torn(result: Result) -> float:
            return float(hardest(result) > CAPTURED_M_S2)

        for title, unit, measure, bound in (
            ("miss", "m", miss, "waypoint on"),
            ("hardest acceleration beside the root", "m/s2", hardest, None),
            ("harder than in any captured walk", "share", is_torn, "torn"),
        ):
            context.add_goal(
                FAMILY, f"{row}: {title}", unit, results, measure, bound=bound, from_standing=True, first=lead
            )
        worst = max(results, key=hardest)
        title = f"{row}: {hardest(worst):.0f} m/s2 at most beside the root"
        context.show(FAMILY, [Exhibit(title, result_frames(worst, lead - context.fps // 2))])


def _take(context: Context, row: str, seed: int, place: Tensor) -> Take:
    lead, there = context.frames(LEAD_S), context.frames(LEAD_S + WAY_S)
    targets = Targets(context.skeleton)
    targets.add_waypoints([lead, there], torch.stack([torch.zeros(2), place]))
    return Take(row, seed, there + context.frames(AFTER_S), ((0, STAND),), targets=targets)
