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
def test_a_wrong_value_is_refused_by_name(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        EngineConfig(**{field: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("history_crop", [0, 6, 164])
def test_a_history_that_the_model_cannot_take_is_refused(history_crop: int) -> None:
    with pytest.raises(ValueError, match="multiples of 4 from 4 to 160"):
        EngineConfig(history_crop=history_crop).check_against(FACTS)


def test_windows_must_be_longer_than_the_threshold_that_starts_them() -> None:
    with pytest.raises(ValueError, match="continue_threshold"):
        EngineConfig(continue_threshold=36, continue_jitter=4).check_against(FACTS)
    EngineConfig(continue_threshold=35, continue_jitter=4).check_against(FACTS)


def test_the_lead_is_the_way_there_and_back_and_a_margin() -> None:
    config = dataclasses.replace(EngineConfig(), rtt_s=0.2, flush_s=0.05, margin_s=0.1)
    assert config.delivery_s == pytest.approx(0.25)
    assert config.commit_s == pytest.approx(0.35)
