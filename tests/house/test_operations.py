"""docs/operations.md: the metrics, settings and alerts that it names are those that exist."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import Any

from motiongen_server.config import ServerConfig
from motiongen_server.ops.metrics import Metrics

PACKAGES = {"motiongen_ardy", "motiongen_client", "motiongen_server", "motiongen_tools"}


def page(repository: Any) -> str:
    return str((repository.root / "docs" / "operations.md").read_text(encoding="utf-8"))


def test_page_lists_every_metric_and_no_other(repository: Any) -> None:
    there = {
        f"{family.name}_total" if family.type == "counter" else family.name for family in Metrics().registry.collect()
    }
    named = set(re.findall(r"\b(?:motiongen|process)_[a-z_]+[a-z]\b", page(repository))) - PACKAGES
    assert sorted(named - there) == [], "on the page, but not served"
    assert sorted(name for name in there - named if name.startswith("motiongen_")) == [], "served, but not on the page"


def test_settings_on_the_page_exist(repository: Any) -> None:
    known = {f"--{each.name.replace('_', '-')}" for each in fields(ServerConfig)}
    assert sorted(set(re.findall(r"`(--[a-z-]+)`", page(repository))) - known) == []


def test_runbook_has_an_entry_for_every_alert_and_no_other(repository: Any) -> None:
    rules = (repository.root / "deploy" / "prometheus" / "alerts.yaml").read_text(encoding="utf-8")
    alerts = re.findall(r"(?m)^ *- alert: (\w+)$", rules)
    assert alerts
    assert re.findall(r"(?m)^### `(\w+)`$", page(repository)) == alerts, "in the order of the rules"
