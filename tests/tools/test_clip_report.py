"""What `motiongen generate` reports of constraints: each sample's residual, and whether the constraint was met."""

from __future__ import annotations

import io

import numpy as np
from rich.console import Console

from motiongen_client import Motion, Rig, Waypoint
from motiongen_client.types import Clip, Deviation, Residual
from motiongen_tools.cli_generate import clip_report, residual_table

WAYPOINT = Waypoint(3, 0.0, 1.0)


def clip_of(rig: Rig, worst_m: float, met: bool) -> Clip:
    motion = Motion(rig, 0, np.zeros((4, rig.row_width), dtype=np.float32))
    residual = Residual(1, Deviation(worst_m, worst_m), None, None, met)
    return Clip("fake", 1, 4, motion, (residual,))


def test_the_report_says_whether_a_constraint_was_met(stick_rig: Rig) -> None:
    for met in (True, False):
        (residual,) = clip_report(clip_of(stick_rig, 0.05, met), [WAYPOINT])["residuals"]
        assert residual["met"] is met
        assert residual["position_m"] == {"mean": 0.05, "worst": 0.05}


def test_the_table_counts_the_samples_that_met_a_constraint(stick_rig: Rig) -> None:
    clips = [clip_of(stick_rig, 0.05, True), clip_of(stick_rig, 0.04, True), clip_of(stick_rig, 0.3, False)]
    console = Console(file=io.StringIO(), width=120)
    console.print(residual_table(clips, [WAYPOINT]))
    told = console.file.getvalue()  # type: ignore[attr-defined]
    assert "30.0 cm" in told
    assert "2 of 3" in told
