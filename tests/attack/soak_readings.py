"""The readings of a soak, saved line by line, and their judgement: memory, descriptors, tasks, misses."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

WARM_S = 1200.0
"""In the first minutes, caches that fill look like growth."""
MOST_MIB_AN_HOUR = 1.0
MOST_MISSED = 0.01
CONFIDENCE = 0.95
PROCESSES = ("gateway", "engine")
POOLED_THREADS = 2
"""By how many a process's threads may grow: the pools of gRPC and asyncio are bounded, and add a thread when all others
are busy, which may happen late. A leak would grow with the sessions, of which there are thousands."""


@dataclass(frozen=True)
class Reading:
    """The server's state at one time. at_s: since it was ready. rest: no session and no stream is open.

    tasks: of the gateway's event loop.
    """

    at_s: float
    rest: bool
    gateway_mib: float
    engine_mib: float
    gateway_descriptors: int
    engine_descriptors: int
    gateway_threads: int
    engine_threads: int
    tasks: int


@dataclass(frozen=True)
class Part:
    """The result of one part of the load. failed: "" or why. lag_ms: by how much the load itself was late (p99)."""

    opens: int
    edits: int
    due: int
    missed: int
    refused: int
    lag_ms: float
    failed: str = ""


class Journal:
    """A file to which everything is written at once, so that a soak that is cut short has a result, too."""

    def __init__(self, path: Path) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)

    def begin(self, facts: dict[str, Any]) -> None:
        """Start a new file. facts: about this run."""
        self.path.write_text("", encoding="utf-8")
        self._add("run", facts)

    def add(self, noted: Reading | Part) -> None:
        self._add("reading" if isinstance(noted, Reading) else "part", asdict(noted))

    def read(self) -> tuple[dict[str, Any], list[Reading], list[Part]]:
        """Facts, readings and parts. Raises ValueError if the file is not a journal."""
        facts: dict[str, Any] = {}
        readings, parts = [], []
        for line in self.path.read_text(encoding="utf-8").splitlines():
            (kind, values), *more = json.loads(line).items()
            if more or kind not in ("run", "reading", "part"):
                raise ValueError(f"{self.path} has a line of kind {kind!r}; it is not the journal of a soak")
            if kind == "run":
                facts = values
            elif kind == "reading":
                readings.append(Reading(**values))
            else:
                parts.append(Part(**values))
        return facts, readings, parts

    def _add(self, kind: str, values: dict[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({kind: values}) + "\n")


def slope_with_bound(hours: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """The slope of a line through the values, per hour, and its one-sided upper 95 % bound.

    Successive values are correlated, which makes a bound for independent ones too low: the error is widened as for a
    first-order process with the residuals' own correlation r, by sqrt((1 + r) / (1 - r)). The quantile of Student's t
    is from the expansion of Abramowitz and Stegun, 26.7.5. NaN and infinity for fewer than four values.
    """
    if len(hours) < 4:
        return math.nan, math.inf
    x, y = np.array(hours, float), np.array(values, float)
    slope, offset = np.polyfit(x, y, 1)
    residuals = y - slope * x - offset
    free = len(x) - 2
    variance = float((residuals**2).sum()) / free
    error = math.sqrt(variance / float(((x - x.mean()) ** 2).sum()))
    if variance > 1e-18:
        alike = float((residuals[1:] * residuals[:-1]).sum() / (residuals**2).sum())
        alike = min(max(alike, 0.0), 0.99)
        error *= math.sqrt((1 + alike) / (1 - alike))
    z = NormalDist().inv_cdf(CONFIDENCE)
    quantile = z + (z**3 + z) / (4 * free) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * free**2)
    return float(slope), float(slope + quantile * error)


def by_minute(readings: Sequence[Reading], name: str) -> tuple[list[float], list[float]]:
    """Hours and means of a figure, one for each whole minute with load."""
    minutes: dict[int, list[float]] = {}
    for each in readings:
        if not each.rest:
            minutes.setdefault(int(each.at_s // 60), []).append(float(getattr(each, name)))
    return [minute / 60 for minute in minutes], [sum(values) / len(values) for values in minutes.values()]


def at_rests(readings: Sequence[Reading], name: str) -> tuple[list[float], list[float]]:
    """Hours and a figure at the end of each rest, when everything is closed and memory has been given back."""
    follows_rest = [one.rest for one in readings[1:]] + [False]
    ends = [one for one, goes_on in zip(readings, follows_rest, strict=False) if one.rest and not goes_on]
    return [one.at_s / 3600 for one in ends], [float(getattr(one, name)) for one in ends]


def judge(readings: Sequence[Reading], parts: Sequence[Part], warm_s: float) -> tuple[list[str], list[str]]:
    """Lines with the result, and the bounds that do not hold."""
    told, faults = [], []
    due, missed = sum(part.due for part in parts), sum(part.missed for part in parts)
    share = missed / due if due else math.nan
    opens, edits = sum(part.opens for part in parts), sum(part.edits for part in parts)
    refused, lag_ms = sum(part.refused for part in parts), max((part.lag_ms for part in parts), default=0)
    told.append(f"{opens} sessions opened, {edits} edits, {refused} refused; {missed} of {due} frames missed "
                f"({share:.3%}); the load itself was late by up to {lag_ms:.0f} ms (p99)")  # fmt: skip
    if not share < MOST_MISSED:
        faults.append(f"{share:.2%} of the frames were missed, allowed are {MOST_MISSED:.0%}")
    faults += [f"a part of the load failed: {part.failed}" for part in parts if part.failed]
    later = [each for each in readings if each.at_s >= warm_s]
    for process in PROCESSES:
        for when, course in (("at rest", at_rests), ("under load", by_minute)):
            hours, mib = course(later, f"{process}_mib")
            slope, bound = slope_with_bound(hours, mib)
            there = f"{mib[0]:.1f} -> {mib[-1]:.1f} MiB" if mib else "no reading after the warm-up"
            told.append(f"{process} {when}: {there}, {slope:+.2f} MiB an hour, at most {bound:+.2f} (95 %)")
            # What is open at one time differs from part to part; what remains at rest must not.
            if course is at_rests and not bound < MOST_MIB_AN_HOUR:
                fault = f"memory at rest grows by up to {bound:.2f} MiB an hour, allowed is {MOST_MIB_AN_HOUR:g}"
                faults.append(f"{process}: {fault}")
    resting = [each for each in readings if each.rest]
    for name in [f"{process}_{what}" for process in PROCESSES for what in ("descriptors", "threads")] + ["tasks"]:
        counts = [int(getattr(each, name)) for each in resting]
        if len(counts) < 2:
            faults.append(f"{name.replace('_', ' ')}: there were not two rests to compare")
            continue
        third = max(1, len(counts) // 3)
        first, last = max(counts[:third]), min(counts[-third:])
        told.append(f"{name.replace('_', ' ')} at rest: {counts[0]} first, {counts[-1]} last, {max(counts)} at most")
        allowed = POOLED_THREADS if name.endswith("threads") else 0
        if last > first + allowed:
            faults.append(f"{name.replace('_', ' ')} at rest grew from {first} to {last}")
    return told, faults
