"""What sessions are expected to ask for, beside the windows that were made for them."""

from __future__ import annotations

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Priority
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import Stage, prompt

STEPS = 4
PLAYING_HZ = FACTS.fps / FACTS.horizon


@pytest.mark.parametrize("every_s", [0.3, 1.0, 2.5, 5.0])
def test_who_is_edited_is_expected_to_ask_for_the_windows_that_edits_make(every_s: float) -> None:
    """A replan replaces what is left of a plan: it costs less than a window beside those that playing on takes."""
    stage = Stage(EngineConfig(degrade=False))
    viewers = [
        stage.open(handle, priority=Priority.NEAR, num_steps=STEPS, prompts=(prompt(1),)) for handle in range(1, 17)
    ]
    stage.run(5.0)
    began_at, before = stage.clock.now(), len(stage.reports)
    for turn in range(round(40.0 / every_s)):
        for viewer in viewers:
            stage.set_prompts(viewer, prompt(turn % 7))
            stage.run(every_s / len(viewers))
    steps = sum(report.rows for report in stage.reports[before:])
    made_hz = steps / STEPS / (stage.clock.now() - began_at) / len(viewers)
    assert made_hz > PLAYING_HZ
    assert stage.engine.admission.expected_hz(Priority.NEAR) == pytest.approx(made_hz, rel=0.1)
