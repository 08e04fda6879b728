"""Context: what every part of the evaluation works with, and how a row with a goal is made."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.evaluate.bounds import bounds
from motiongen_ardy.evaluate.cases import MOVING, STANDING, Captured, Case
from motiongen_ardy.evaluate.figure import Bound, Company, Figure, Sample, summarize
from motiongen_ardy.evaluate.judge import TextJudge
from motiongen_ardy.evaluate.measures.feet import slowest_foot
from motiongen_ardy.evaluate.measures.root import is_running
from motiongen_ardy.evaluate.measures.smooth import accelerations
from motiongen_ardy.evaluate.sampler import Sampler
from motiongen_ardy.evaluate.take import Result, Take


@dataclass(frozen=True)
class Size:
    """How much is run. moving, standing, sessions, matched: clips or sessions per row; long_s: seconds."""

    seeds: int = 2
    moving: int = 16
    standing: int = 6
    sessions: int = 16
    matched: int = 96
    long_s: int = 600
    long_sessions: int = 3


QUICK = Size(seeds=1, moving=6, standing=3, sessions=6, matched=48, long_s=60, long_sessions=2)


@dataclass(frozen=True)
class Exhibit:
    """A take to be drawn. goals: (frame, x, z) in metres; path: ground positions (K, 2) that were asked for."""

    title: str
    result: Result
    goals: tuple[tuple[int, float, float], ...] = ()
    path: np.ndarray | None = None


@dataclass
class Context:
    """figures, unjudged and exhibits grow as the parts run.

    judge: of text and motion; None if not needed. unjudged: rows with a bound for which there was no take.
    """

    sampler: Sampler
    cases: list[Case]
    captured: Captured
    size: Size
    raw: bool = False
    judge: TextJudge | None = None
    figures: list[Figure] = field(default_factory=list)
    unjudged: list[str] = field(default_factory=list)
    exhibits: dict[str, list[Exhibit]] = field(default_factory=dict)

    @property
    def layout(self) -> Representation:
        return self.sampler.model.representation

    @property
    def skeleton(self) -> Skeleton:
        return self.layout.skeleton

    @property
    def fps(self) -> int:
        return self.layout.fps

    @property
    def seeds(self) -> range:
        return range(self.size.seeds)

    def frames(self, seconds: float) -> int:
        return round(seconds * self.fps)

    def bound(self, name: str, group: str = MOVING) -> Bound | None:
        """The bound of that name; standing clips have none."""
        return bounds(self.raw)[name] if group == MOVING else None

    def chosen(self, group: str, num_frames: int, count: int | None = None, contents: Sequence[str] = ()) -> list[Case]:
        """Captured cases of a group, at least num_frames long, spread over contents (with the prefixes `contents`)."""
        count = (self.size.moving if group == MOVING else self.size.standing) if count is None else count
        fit = [
            case
            for case in self.cases
            if case.group == group
            and not case.derived
            and case.num_frames >= num_frames
            and (not contents or any(case.content.startswith(name) for name in contents))
        ]
        return fit[:count]

    def both(self, num_frames: int) -> list[Case]:
        """Moving, then standing cases that are at least num_frames long."""
        return self.chosen(MOVING, num_frames) + self.chosen(STANDING, num_frames)

    def show(self, family: str, exhibits: Iterable[Exhibit]) -> None:
        """Add a few takes to a family's sheet."""
        self.exhibits.setdefault(family, []).extend(exhibits)

    def add(self, figure: Figure | None) -> None:
        if figure is not None:
            self.figures.append(figure)

    def company(self, results: Sequence[Result], from_standing: bool = False, first: int | None = None) -> Company:
        """Feet and accelerations of the generated frames of takes. first: measure from there on.

        Takes that walk and takes that run are each compared with captures of their pace.
        """
        motions = [
            result.positions[max(0, result.take.history_len - 2) if first is None else first :] for result in results
        ]
        runs = [positions for positions in motions if is_running(positions[:, 0, [0, 2]], self.fps)]
        walks = [positions for positions in motions if not is_running(positions[:, 0, [0, 2]], self.fps)]
        bound = self.bound("feet start" if from_standing else "feet steady")
        most = math.inf if bound is None or bound.most is None else bound.most
        paces = ((walks, self.captured.walking, most), (runs, self.captured.running, most + self.captured.running.feet))
        kept = True
        for group, captured, limit in paces:
            feet, acceleration = self._feet(group)
            kept &= feet is None or feet <= limit
            kept &= acceleration is None or acceleration <= captured.acceleration
        return Company(*self._feet(motions), kept)

    def _feet(self, motions: Sequence[Tensor]) -> tuple[float | None, float | None]:
        """Slowest foot over root speed, and p99 of accelerations, of positions (T, J, 3); None if there is none."""
        ratios = [slowest_foot(self.skeleton, positions, self.fps) for positions in motions]
        known = [value for value in ratios if not math.isnan(value)]
        steps = [accelerations(positions, self.fps).flatten() for positions in motions]
        acceleration = float(np.quantile(torch.cat(steps).numpy(), 0.99)) if steps else None
        return (float(np.mean(known)) if known else None), acceleration

    def add_goal(
        self,
        family: str,
        row: str,
        unit: str,
        results: Sequence[Result],
        measure: Callable[[Result], float],
        *,
        bound: str | None = None,
        from_standing: bool = False,
        more_is_better: bool = False,
        first: int | None = None,
        data: Callable[[Result], float] | None = None,
    ) -> None:
        """Add a row for each group that has takes: the measure, and their feet and accelerations."""
        for group in (MOVING, STANDING):
            takes = [result for result in results if result.take.group == group]
            if not takes:
                if group == MOVING and bound is not None:
                    self.unjudged.append(f"{family}: {row}")
                continue
            samples = [Sample(result.take.case, measure(result)) for result in takes]
            limit = None if bound is None else self.bound(bound, group)
            company = self.company(takes, from_standing or group == STANDING, first)
            known = [] if data is None else [data(result) for result in takes]
            known = [value for value in known if not math.isnan(value)]
            figure = summarize(
                (family, row, group),
                unit,
                samples,
                bound=limit,
                data=float(np.mean(known)) if known else None,
                company=company,
                more_is_better=more_is_better,
            )
            if figure is None and limit is not None:
                self.unjudged.append(f"{family}: {row}")
            self.add(figure)

    def run(self, takes: Sequence[Take]) -> list[Result]:
        return self.sampler.run(takes)
