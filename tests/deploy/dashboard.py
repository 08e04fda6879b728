"""The Grafana dashboard of deploy/grafana, read as its panels and their queries."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
DASHBOARD = REPOSITORY / "deploy" / "grafana" / "dashboards" / "motiongen.json"
_RANGE = re.compile(r"\$__rate_interval")
_METRIC = re.compile(r"\b(?:motiongen|process)_[a-z_]+[a-z]\b")
_OF_A_HISTOGRAM = re.compile(r"_(bucket|sum|count)$")


@dataclass(frozen=True)
class Query:
    """PromQL of a panel, with Grafana's variables in it. legend: a name with labels in double braces."""

    expression: str
    legend: str

    def filled(self, rate_interval: str, instances: str = ".*") -> str:
        """The query as Grafana would send it, for these servers and this rate interval."""
        return _RANGE.sub(rate_interval, self.expression).replace("$instance", instances)

    def metrics(self) -> set[str]:
        """The names of the metrics in it, as `/metrics` declares them."""
        return {_OF_A_HISTOGRAM.sub("", name) for name in _METRIC.findall(self.expression)}


@dataclass(frozen=True)
class Panel:
    """One chart. row: the heading above it. place: x, y, width and height on the dashboard's grid."""

    title: str
    row: str
    description: str
    unit: str
    limit: float | None
    queries: tuple[Query, ...]
    place: tuple[int, int, int, int]


def panels(dashboard: Path = DASHBOARD) -> Iterator[Panel]:
    """All charts, from top to bottom."""
    row = ""
    for each in json.loads(dashboard.read_text(encoding="utf-8"))["panels"]:
        if each["type"] == "row":
            row = each["title"]
            continue
        defaults, grid = each["fieldConfig"]["defaults"], each["gridPos"]
        limits = [step["value"] for step in defaults["thresholds"]["steps"] if step["value"] is not None]
        yield Panel(
            each["title"],
            row,
            each["description"],
            defaults["unit"],
            limits[0] if limits else None,
            tuple(Query(target["expr"], target["legendFormat"]) for target in each["targets"]),
            (grid["x"], grid["y"], grid["w"], grid["h"]),
        )
