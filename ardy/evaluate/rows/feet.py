"""Feet in a steady walk, in the first steps after standing, and in a stop."""

from __future__ import annotations

import math
from collections.abc import Callable

from torch import Tensor

from ardy.evaluate.cases import MOVING
from ardy.evaluate.context import Context, Exhibit
from ardy.evaluate.measures import feet
from ardy.evaluate.rows.velocity import STAND, WALK
from ardy.evaluate.take import Result, Take

FAMILY = "feet"
Measure = Callable[[Result, int], float]


def add(context: Context) -> None:
    """All rows of feet: sessions without history, under prompts alone."""
    lead = context.frames(3)
    seeds = range(context.size.sessions)
    steady = [Take("walk", seed, context.frames(6), ((0, WALK),)) for seed in seeds]
    starts = [Take("start", seed, lead + context.frames(3), ((0, STAND), (lead, WALK))) for seed in seeds]
    stops = [Take("stop", seed, lead + context.frames(3), ((0, WALK), (lead, STAND))) for seed in seeds]
    results = context.run([*steady, *starts, *stops])
    walks, begun, ended = (results[first : first + len(seeds)] for first in range(0, len(results), len(seeds)))
    _steady(context, walks)
    _start(context, begun, lead)
    _stop(context, ended, lead)


def _steady(context: Context, walks: list[Result]) -> None:
    """Figures of the last four of six seconds, beside those of captured walks."""
    skeleton, fps, first = context.skeleton, context.fps, context.frames(2)

    def contact_skate(positions: Tensor, result: Result) -> float:
        contacts = result.features[-len(positions) :, context.layout.contact_block] > 0.5
        return feet.skate_in_contact(skeleton, positions, contacts, fps)

    measures: dict[tuple[str, str, str | None], Callable[[Tensor, Result], float]] = {
        ("steady walk: slowest foot / root speed", "", "feet steady"): lambda p, _: feet.slowest_foot(skeleton, p, fps),
        ("steady walk: skate in contact", "m/s", None): contact_skate,
        ("steady walk: skating ratio", "", None): lambda p, _: feet.skating_ratio(skeleton, p),
        ("steady walk: height of the lower toe", "m", None): lambda p, _: feet.foot_height(skeleton, p),
        ("steady walk: penetration", "m", None): lambda p, _: feet.penetration(skeleton, p),
        ("steady walk: gliding frames", "", None): lambda p, _: feet.glide_share(skeleton, p, fps),
    }
    captured = [case.motion for case in context.chosen(MOVING, 40, 10_000, ("walk",))]
    for (row, unit, bound), measure in measures.items():
        known = [value for one in captured if not math.isnan(value := measure(one.positions, one))]
        data = sum(known) / len(known) if known else math.nan
        context.add_goal(
            FAMILY,
            row,
            unit,
            walks,
            lambda result, measure=measure: measure(result.positions[first:], result),
            bound,
            first=first,
            data=None if not known else lambda _, data=data: data,
        )
    context.show(FAMILY, [Exhibit(f"steady walk, seed {result.take.seed}", result) for result in walks[:2]])


def _start(context: Context, begun: list[Result], lead: int) -> None:
    skeleton, fps = context.skeleton, context.fps

    def slowest(result: Result) -> float:
        return feet.slowest_foot(skeleton, result.positions[lead : lead + 2 * fps], fps)

    def time(result: Result) -> float:
        return feet.first_lift(skeleton, result.positions, lead, fps)[0]

    def glided(result: Result) -> float:
        return feet.first_lift(skeleton, result.positions, lead, fps)[1]

    row = "stand to walk: slowest foot / root speed, first 2 s"
    context.add_goal(FAMILY, row, "", begun, slowest, "feet start", from_standing=True, first=lead)
    context.add_goal(FAMILY, "stand to walk: to the first lifted foot", "s", begun, time, first=lead)
    row = "stand to walk: glided before the first lifted foot"
    context.add_goal(FAMILY, row, "m", begun, glided, "glided", from_standing=True, first=lead)
    exhibits = [Exhibit(f"stand to walk at 3 s: glides {glided(one):.2f} m", one) for one in begun[:2]]
    context.show(FAMILY, exhibits)


def _stop(context: Context, ended: list[Result], lead: int) -> None:
    skeleton, fps = context.skeleton, context.fps

    def time(result: Result) -> float:
        return feet.stop(skeleton, result.positions, lead, fps)[0]

    def steps(result: Result) -> float:
        return float(feet.stop(skeleton, result.positions, lead, fps)[1])

    def slowest(result: Result) -> float:
        return feet.slowest_foot(skeleton, result.positions[lead : lead + 2 * fps], fps)

    context.add_goal(FAMILY, "walk to stand: to a stop", "s", ended, time, first=lead)
    context.add_goal(FAMILY, "walk to stand: steps", "steps", ended, steps, first=lead)
    context.add_goal(FAMILY, "walk to stand: slowest foot / root speed, first 2 s", "", ended, slowest, first=lead)
    context.show(FAMILY, [Exhibit(f"walk to stand at 3 s: {time(one):.1f} s", one) for one in ended[:2]])
