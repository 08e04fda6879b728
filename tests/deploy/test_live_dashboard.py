"""Every query of the dashboard, with a real Prometheus that watches a real server with characters."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator

import pytest
import yaml

from tests.deploy.dashboard import REPOSITORY, Panel, panels
from tests.deploy.watched_servers import Prometheus
from tests.scale.replicas import NULL_SERVER, Replica
from tests.waiting import until

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

QUIET = {
    "Sessions refused",
    "Sessions resumed",
    "Prompts not in memory",
    "Clips",
}
"""Panels that may be empty: a server without trouble and without clips has no values for their labels yet."""


@pytest.fixture(scope="module")
def prometheus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prometheus]:
    """A Prometheus that has watched some seconds of a scenario with all classes."""
    folder = tmp_path_factory.mktemp("watched")
    server = Replica("server", folder, f"sqlite:{folder / 'snapshots.sqlite'}", program=NULL_SERVER)
    server.begin()
    try:
        until(lambda: server.is_ready)
        with Prometheus(folder, [server.behind.ops_port]) as watching:
            load = subprocess.run(
                [
                    *(sys.executable, "-m", "motiongen_tools", "bench", "--server", f"localhost:{server.behind.port}"),
                    *("--scenario", "mixed", "--characters", "20", "--seconds", "8", "--seed", "1"),
                    *("--processes", "1", "--max-lag-ms", "100000", "--out", str(folder / "load")),
                ],
                cwd=REPOSITORY,
                capture_output=True,
                text=True,
            )
            assert load.returncode in (0, 3), (
                load.stdout + load.stderr
            )  # 3: the load was late, which does not matter here
            yield watching
    finally:
        server.stop()


@pytest.mark.parametrize("panel", list(panels()), ids=lambda panel: panel.title)
def test_panel_has_values(prometheus: Prometheus, panel: Panel) -> None:
    for query in panel.queries:
        found = prometheus.query(query.filled("5m"))
        assert found or panel.title in QUIET, query
        for series in found:
            assert set(re.findall(r"{{(\w+)}}", query.legend)) <= set(series["metric"]), (query, series["metric"])


def test_queries_can_be_limited_to_a_server(prometheus: Prometheus) -> None:
    (server,) = prometheus.query("motiongen_build_info")
    query = next(panels()).queries[0]
    assert prometheus.query(query.filled("5m", server["metric"]["instance"]))
    assert prometheus.query(query.filled("5m", "another:1")) == []


def test_autoscaling_metric_has_a_value(prometheus: Prometheus) -> None:
    """The query of prometheus-adapter, but without the labels for namespace and pod that Kubernetes adds."""
    rules = REPOSITORY / "deploy" / "kubernetes" / "overlays" / "autoscaling" / "adapter-rules.yaml"
    (rule,) = yaml.safe_load(rules.read_text(encoding="utf-8"))["rules"]
    asked = (
        rule["metricsQuery"]
        .replace("<<.GroupBy>>", "instance")
        .replace("<<.Series>>", rule["name"]["matches"].strip("^$"))
    )
    (found,) = prometheus.query(asked.replace("{<<.LabelMatchers>>}", ""))
    assert 0 <= float(found["value"][1]) <= 1
