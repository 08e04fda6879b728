"""The dashboard queries existing metrics, in panels with descriptions."""

from __future__ import annotations

import json
import re

import yaml

from motiongen_server.ops.metrics import Metrics
from tests.deploy.dashboard import DASHBOARD, REPOSITORY, panels

PROVISIONING = REPOSITORY / "deploy" / "grafana" / "provisioning"
PROMETHEUS_OWN = {"process_start_time_seconds"}


def served() -> dict[str, str]:
    """Every metric as Prometheus names it -> its type."""
    return {
        f"{family.name}_total" if family.type == "counter" else family.name: family.type
        for family in Metrics().registry.collect()
    }


def test_every_metric_of_a_panel_is_served() -> None:
    asked = {name for panel in panels() for query in panel.queries for name in query.metrics()}
    assert sorted(asked - set(served()) - PROMETHEUS_OWN) == []
    assert len(asked) >= 40


def test_rates_are_taken_only_of_counters_and_histograms() -> None:
    kinds = served()
    for panel in panels():
        for query in panel.queries:
            for name in re.findall(r"\brate\((\w+?)(?:_bucket|_sum|_count)?\{", query.expression):
                assert kinds[name] in ("counter", "histogram"), (panel.title, name)


def test_every_panel_has_a_description_and_a_place_of_its_own() -> None:
    taken: set[tuple[int, int]] = set()
    titles = []
    for panel in panels():
        assert panel.description.endswith("."), panel.title
        assert panel.row, panel.title
        assert panel.queries, panel.title
        assert all(query.legend for query in panel.queries), panel.title
        x, y, width, height = panel.place
        cells = {(column, line) for column in range(x, x + width) for line in range(y, y + height)}
        assert x + width <= 24, panel.title
        assert not cells & taken, panel.title
        taken |= cells
        titles.append(panel.title)
    assert len(set(titles)) == len(titles) > 25


def test_every_query_is_limited_to_the_chosen_servers() -> None:
    for panel in panels():
        for query in panel.queries:
            assert query.expression.count("{") == query.expression.count('instance=~"$instance"'), panel.title


def test_grafana_finds_its_dashboards_and_prometheus() -> None:
    compose = yaml.safe_load((REPOSITORY / "deploy" / "compose.yaml").read_text(encoding="utf-8"))
    mounted = dict(volume.split(":")[:2] for volume in compose["services"]["grafana"]["volumes"])
    provider = yaml.safe_load((PROVISIONING / "dashboards" / "motiongen.yaml").read_text(encoding="utf-8"))
    path = provider["providers"][0]["options"]["path"]
    assert mounted["./grafana/dashboards"] == path
    assert mounted["./grafana/provisioning"] == "/etc/grafana/provisioning"
    source = yaml.safe_load((PROVISIONING / "datasources" / "prometheus.yaml").read_text(encoding="utf-8"))
    host = re.fullmatch(r"http://([a-z]+):9090", source["datasources"][0]["url"])
    assert host
    shared = set(compose["services"][host[1]]["networks"]) & set(compose["services"]["grafana"]["networks"])
    assert shared, "they share no network"


def test_panels_use_the_chosen_data_source() -> None:
    text = DASHBOARD.read_text(encoding="utf-8")
    variables = {each["name"] for each in json.loads(text)["templating"]["list"]}
    assert variables == {"datasource", "instance"}
    assert set(re.findall(r'"uid": "([^"]+)"', text)) == {"${datasource}", "motiongen"}
