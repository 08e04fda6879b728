"""The share of discarded denoising steps, as read from a server's metrics."""

import pytest

from motiongen_tools.bench.server_use import thrown_away, total

METRICS = """# HELP motiongen_batch_rows Rows in a denoising step.
# TYPE motiongen_batch_rows histogram
motiongen_batch_rows_bucket{engine="0",le="1.0",model="core27"} 3.0
motiongen_batch_rows_sum{engine="0",model="core27"} 120.0
motiongen_batch_rows_sum{engine="1",model="core27"} 80.0
motiongen_steps_discarded_total{engine="0",model="core27"} 6.0
motiongen_steps_discarded_total{engine="1",model="core27"} 4.0
motiongen_frames_sent_total 17.0
"""


def test_a_metric_is_summed_over_its_labels() -> None:
    assert total(METRICS, "motiongen_batch_rows_sum") == 200.0
    assert total(METRICS, "motiongen_steps_discarded_total") == 10.0
    assert total(METRICS, "motiongen_frames_sent_total") == 17.0
    assert total(METRICS, "motiongen_steps") == 0.0


def test_the_share_of_discarded_steps_is_that_between_two_readings() -> None:
    assert thrown_away((200.0, 10.0), (300.0, 12.0)) == pytest.approx(0.02)
    assert thrown_away((200.0, 10.0), (200.0, 10.0)) is None
    assert thrown_away(None, (300.0, 12.0)) is None
