import dataclasses

import pytest

from motiongen_server.engine.config import EngineConfig
from tests.server.engine.fakes import FACTS


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("max_sessions", 0),
        ("max_rows", 0),
        ("first_chunk", 0),
        ("history_crop", -4),
        ("rtt_s", -0.1),
        ("margin_s", float("nan")),
        ("idle_timeout_s", 0.0),
        ("edit_target_s", (0.1, 0.1, 0.1, 0.0)),
        ("edit_target_s", (0.1,)),
    ],
)
def test_invalid_value_is_refused_naming_its_field(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        EngineConfig(**{field: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("history_crop", [0, 6, 164])
def test_history_length_that_the_model_cannot_take_is_refused(history_crop: int) -> None:
    with pytest.raises(ValueError, match="multiples of 4 from 4 to 160"):
        EngineConfig(history_crop=history_crop).check_against(FACTS)


def test_continue_threshold_and_jitter_must_stay_below_the_horizon() -> None:
    with pytest.raises(ValueError, match="continue_threshold"):
        EngineConfig(continue_threshold=36, continue_jitter=4).check_against(FACTS)
    EngineConfig(continue_threshold=35, continue_jitter=4).check_against(FACTS)


def test_lead_is_the_sum_of_round_trip_flush_interval_and_margin() -> None:
    config = dataclasses.replace(EngineConfig(), rtt_s=0.2, flush_s=0.05, margin_s=0.1)
    assert config.delivery_s == pytest.approx(0.25)
    assert config.commit_s == pytest.approx(0.35)
