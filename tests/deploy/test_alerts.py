"""Alerts hold through what a server makes of its engines: one that says nothing is given up before a minute is over."""

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


def test_who_has_no_engine_that_goes_round_for_a_minute_is_not_well() -> None:
    """Its age alone would not do: at 30 s an engine is lost, and counts as what is started anew from then on."""
    not_well = rule("MotiongenNotWell")
    found = re.fullmatch(r"motiongen_engine_heartbeat_age_seconds > (\d+)", not_well["expr"])
    assert found
    assert not_well["for"] == "1m", "longer than an engine may say nothing"
    assert HUNG_S < 60
    link = ModelLink(1, "model", lambda outputs: None, lambda: None)  # nobody has told that it is up
    group = EngineGroup(cast(Any, [(object(), link)]), 1 << 16, 0.9, None)
    now = time.monotonic()
    assert HEARTBEAT_LIMIT_S <= float(found[1]) < now - group.heartbeat_at
