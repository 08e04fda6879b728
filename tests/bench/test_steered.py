"""How the built-in model moves when steered by a stick, through the engine with its usual scheduling."""

import numpy as np
import pytest

from motiongen_ardy.capabilities import read_capabilities
from motiongen_ardy.checkpoint.model_card import model_folder
from tests.bench.costed_runner import Costs
from tests.bench.models import BUILT_IN
from tests.bench.steered import STICKS, Crew, measure, play


@pytest.mark.parametrize("stick", ["in a circle", "weaving"])
def test_feet_do_not_glide_under_a_turning_stick(stick: str) -> None:
    crew = Crew.built_in()
    players = play(crew, [STICKS[stick]] * 2, 4, 8.0, Costs(slower=0.2))
    screens = list(players.screens.values())
    feet, glides, *_ = np.mean([measure(crew, screen, players.now) for screen in screens], axis=0)
    assert feet < 0.05, "the slowest foot's speed over the root's: 0.3 if plans begin at any frame"
    assert glides < 0.12, "0.4 to 0.5 if plans begin at any frame"
    answered = [each for screen in screens for each in screen.playback.latencies_s]
    assert np.median(answered) < 0.1, "the median latency of the stick, s"


@pytest.mark.parametrize(
    ("stick", "fastest"), [("straight on", "run"), ("sideways", "walk-left"), ("backwards", "walk-back")]
)
def test_characters_step_at_the_speeds_that_are_claimed(stick: str, fastest: str) -> None:
    (claimed,) = (gait.to_mps for gait in read_capabilities(model_folder(BUILT_IN)).locomotion if gait.name == fastest)
    crew = Crew.built_in()
    players = play(crew, [STICKS[stick]] * 2, 4, 8.0, Costs(slower=0.2), claimed)
    feet = np.mean([measure(crew, screen, players.now)[0] for screen in players.screens.values()])
    assert feet < 0.1, "the slowest foot's speed over the root's: 0.2 to 0.6 at half a metre a second more"


def test_character_steered_too_fast_walks_again_when_steered_slowly() -> None:
    crew = Crew.built_in()
    players = play(crew, [STICKS["too fast, then ahead"]] * 4, 4, 11.0, Costs(slower=0.2))
    later = [measure(crew, screen, players.now, from_s=8.0) for screen in players.screens.values()]
    assert max(feet for feet, *_ in later) < 0.05, (
        "0.1 to 0.7 for half of them without the correction of floating bodies"
    )
    assert max(glides for _, glides, *_ in later) < 0.15
