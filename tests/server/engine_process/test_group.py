"""Which engine process a session is given to."""

from __future__ import annotations

from collections import Counter
from typing import Any, cast

from motiongen_server.engine.types import Open, SessionKey
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.group import EngineGroup
from motiongen_server.engine_process.messages import Pulse
from motiongen_server.engine_process.model_link import ModelLink
from tests.server.engine.stage import spec


class Process:
    """What a group asks of an engine process that holds one model."""

    def __init__(self, link: ModelLink) -> None:
        self._link = link

    @property
    def load(self) -> float:
        return self._link.load

    @property
    def asked(self) -> float:
        return self._link.asked

    @property
    def num_sessions(self) -> int:
        return self._link.num_sessions


def given(tells: list[tuple[float, float]], opens: int = 1000, tell_every: int = 40) -> Counter[int]:
    """How many sessions each engine is given. tells: what every engine measures and asks for, in hundred sessions."""
    links = [ModelLink(1, "model", lambda outputs: None, lambda: None) for _ in tells]
    for link in links:
        link._is_up = True
    group = EngineGroup(cast(Any, [(Process(link), link) for link in links]), 1 << 16, 0.9)
    for number in range(opens):
        if number % tell_every == 0:
            for link, (load, asked) in zip(links, tells, strict=True):
                hundreds = link.num_sessions / 100
                link.take_pulse(Pulse(1, 0.0, (StepReport(load=load * hundreds, asked=asked * hundreds),)))
        assert group.submit(Open(spec(SessionKey(1, number)), 1, 0.0)) is None
    return Counter({index: link.num_sessions for index, link in enumerate(links)})


def test_engines_that_measure_unlike_loads_of_late_are_given_as_much() -> None:
    found = given([(0.5, 0.4), (0.3, 0.4)])
    assert max(found.values()) - min(found.values()) <= 100 / 20


def test_who_takes_longer_for_a_session_is_given_fewer() -> None:
    found = given([(0.4, 0.4), (0.8, 0.8)])
    assert 1.6 < found[0] / found[1] < 2.4


def test_an_engine_that_told_nothing_yet_is_given_as_many() -> None:
    found = given([(0.0, 0.0), (0.0, 0.0)])
    assert found[0] == found[1]
