"""Figures with their spread: the content of one row of the table."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Bound:
    """The range that a mean must keep: at least `least`, at most `most`, either or both."""

    least: float | None = None
    most: float | None = None

    def met(self, value: float) -> bool:
        return (self.least is None or value >= self.least) and (self.most is None or value <= self.most)

    def __str__(self) -> str:
        if self.least is None:
            return f"<= {self.most:g}"
        return f">= {self.least:g}" if self.most is None else f"{self.least:g} to {self.most:g}"


@dataclass(frozen=True)
class Sample:
    """One take's figure. Takes of one case differ only by seed."""

    case: str
    value: float


@dataclass(frozen=True)
class Company:
    """The other figures of takes with a goal. feet: slowest foot over root speed; acceleration: p99 in m/s2.

    kept: whether both are within their bounds.
    """

    feet: float | None
    acceleration: float | None
    kept: bool


@dataclass(frozen=True)
class Figure:
    """One row of the table, for moving or for standing clips.

    interval: half the 95 % interval of the mean over seeds; None if no case has two seeds. worst_5: the value that one
    in twenty takes exceeds in the bad direction. data: the same figure for the captures. status: "yes", "no", "feet" if
    only feet or accelerations miss theirs, "" without a bound.
    """

    family: str
    row: str
    group: str
    unit: str
    num: int
    mean: float
    worst_5: float
    worst: float
    interval: float | None
    data: float | None
    bound: Bound | None
    company: Company | None
    status: str

    def as_json(self) -> dict[str, Any]:
        """The figure as a JSON object, rounded to four digits."""
        entry = asdict(self)
        entry["bound"] = None if self.bound is None else str(self.bound)
        return {key: _rounded(value) for key, value in entry.items() if value is not None}


def _rounded(value: Any) -> Any:
    """A number with four digits; None if it is not finite, which JSON cannot express."""
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if not isinstance(value, float):
        return value
    return float(f"{value:.4g}") if math.isfinite(value) else None


def summarize(
    name: tuple[str, str, str],
    unit: str,
    samples: Sequence[Sample],
    *,
    bound: Bound | None = None,
    data: float | None = None,
    company: Company | None = None,
    more_is_better: bool = False,
) -> Figure | None:
    """A figure from samples, of which NaN is left out; None if there are no others.

    name: family, row and group.
    """
    samples = [sample for sample in samples if not math.isnan(sample.value)]
    if not samples:
        return None
    values = np.array([sample.value for sample in samples])
    mean = float(values.mean())
    status = ""
    if bound is not None:
        status = "no" if not bound.met(mean) else "yes" if company is None or company.kept else "feet"
    return Figure(
        *name,
        unit,
        len(values),
        mean,
        float(np.quantile(values, 0.05 if more_is_better else 0.95)),
        float(values.min() if more_is_better else values.max()),
        seed_interval(samples),
        data,
        bound,
        company,
        status,
    )


def seed_interval(samples: Sequence[Sample]) -> float | None:
    """Half the 95 % interval of the mean under other seeds for the same cases, from the spread within cases."""
    by_case: dict[str, list[float]] = defaultdict(list)
    for sample in samples:
        by_case[sample.case].append(sample.value)
    freedom = sum(len(values) - 1 for values in by_case.values())
    if freedom < 1:
        return None
    within = sum(float(np.var(values)) * len(values) for values in by_case.values()) / freedom
    # Student's quantile by the Cornish-Fisher expansion; within 2 % from three degrees of freedom on.
    student = 1.96 + (1.96**3 + 1.96) / (4 * freedom) + (5 * 1.96**5 + 16 * 1.96**3 + 3 * 1.96) / (96 * freedom**2)
    return student * math.sqrt(within / len(samples))
