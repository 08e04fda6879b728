"""Feet in a steady walk, in the first steps after standing, and in a stop."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from motiongen_ardy.evaluate.cases import MOVING
from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.measures import feet
from motiongen_ardy.evaluate.rows.velocity import STAND, WALK
from motiongen_ardy.evaluate.take import Result, Take

FAMILY = "feet"
STILL = ("stand", "idle")
GOING = ("walk", "run", "start")


@dataclass(frozen=True)
class _Change:
    """Sessions whose prompt changes, and the same change in the data.

    results: of the sessions; lead: the frame at which their prompt changes. derived: positions, and the frame of each
    change in them.
    """

    context: Context
    results: list[Result]
    lead: int
    derived: list[tuple[Tensor, int]]

    def add(self, row: str, unit: str, measure: Callable[[Tensor, int], float], bound: str | None = None) -> None:
        """Add a row: what `measure` returns for positions (T, J, 3) and the frame of a change."""
        known = [value for positions, frame in self.derived if not math.isnan(value := measure(positions, frame))]
        self.context.add_goal(
            FAMILY,
            row,
            unit,
            self.results,
            lambda result: measure(result.positions, self.lead),
            bound=bound,
            from_standing=row.startswith("stand"),
            first=self.lead,
            data=(lambda _: sum(known) / len(known)) if known else None,
        )

    def slowest(self, positions: Tensor, frame: int) -> float:
        """The speed of the slowest foot over the root's in the two seconds after a change."""
        skeleton, fps = self.context.skeleton, self.context.fps
        return feet.slowest_foot(skeleton, positions[frame : frame + 2 * fps], fps)


def add(context: Context) -> None:
    """Add all rows about feet: sessions without history, with prompts alone."""
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
            bound=bound,
            first=first,
            data=None if not known else lambda _, data=data: data,
        )
    context.show(FAMILY, [Exhibit(f"steady walk, seed {result.take.seed}", result) for result in walks[:2]])


def _start(context: Context, begun: list[Result], lead: int) -> None:
    skeleton, fps = context.skeleton, context.fps

    def time(positions: Tensor, frame: int) -> float:
        return feet.first_lift(skeleton, positions, frame, fps).seconds

    def glided(positions: Tensor, frame: int) -> float:
        return feet.first_lift(skeleton, positions, frame, fps).glided_m

    def leaned(positions: Tensor, frame: int) -> float:
        return feet.first_lift(skeleton, positions, frame, fps).root_m

    change = _Change(context, begun, lead, _changes(context, starts=True))
    row = "stand to walk: slowest foot / root speed, first 2 s"
    change.add(row, "", change.slowest, "feet start")
    change.add("stand to walk: to the first lifted foot", "s", time)
    row = "stand to walk: glided before the first lifted foot"
    change.add(row, "m", glided, "glided")
    change.add("stand to walk: root's way before it", "m", leaned)
    title = "stand to walk at 3 s: glides {:.2f} m"
    context.show(FAMILY, [Exhibit(title.format(glided(one.positions, lead)), one) for one in begun[:2]])


def _stop(context: Context, ended: list[Result], lead: int) -> None:
    skeleton, fps = context.skeleton, context.fps

    def time(positions: Tensor, frame: int) -> float:
        return feet.stop(skeleton, positions, frame, fps)[0]

    def steps(positions: Tensor, frame: int) -> float:
        return float(feet.stop(skeleton, positions, frame, fps)[1])

    change = _Change(context, ended, lead, _changes(context, starts=False))
    change.add("walk to stand: to a stop", "s", time)
    change.add("walk to stand: steps", "steps", steps)
    change.add("walk to stand: slowest foot / root speed, first 2 s", "", change.slowest)
    context.show(
        FAMILY, [Exhibit(f"walk to stand at 3 s: {time(one.positions, lead):.1f} s", one) for one in ended[:2]]
    )


def _changes(context: Context, starts: bool) -> list[tuple[Tensor, int]]:
    """Positions and frame of each change in the data from standing to moving, or back; these are derived clips."""
    return [
        (case.motion.positions, frame)
        for case in context.cases
        for frame, before, after in case.changes
        if (before if starts else after) in STILL
        and (after if starts else before).startswith(GOING)
        and context.fps // 2 <= frame < case.num_frames - context.fps
    ]
