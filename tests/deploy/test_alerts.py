"""The alerts for engines agree with the server, which gives up an unresponsive engine within a minute."""

from __future__ import annotations

import re
import time
from typing import Any, cast

import yaml

from motiongen_server.app import HEARTBEAT_LIMIT_S
from motiongen_server.engine_process.group import EngineGroup
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.engine_process.process import HUNG_S
from tests.deploy.dashboard import REPOSITORY

ALERTS = REPOSITORY / "deploy" / "prometheus" / "alerts.yaml"


def rule(name: str) -> dict[str, Any]:
    (group,) = yaml.safe_load(ALERTS.read_text(encoding="utf-8"))["groups"]
    (found,) = (each for each in group["rules"] if each["alert"] == name)
    return dict(found)


def test_alert_stays_active_while_no_engine_responds() -> None:
    """The server replaces an engine after 30 s, but its heartbeat's age stays above the limit until one is ready."""
    not_well = rule("MotiongenNotWell")
    found = re.fullmatch(r"motiongen_engine_heartbeat_age_seconds > (\d+)", not_well["expr"])
    assert found
    assert not_well["for"] == "1m", "longer than an engine may be unresponsive"
    assert HUNG_S < 60
    link = ModelLink(1, "model", lambda outputs: None, lambda: None)  # never reported as up
    group = EngineGroup(cast(Any, [(object(), link)]), 1 << 16, 0.9, None)
    now = time.monotonic()
    assert HEARTBEAT_LIMIT_S <= float(found[1]) < now - group.heartbeat_at
