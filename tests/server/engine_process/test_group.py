"""Which engine process a session is given to."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from math import inf
from typing import Any, cast

from motiongen_server.engine.types import Close, CloseReason, Open, Owner, Priority, SessionKey
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.group import EngineGroup
from motiongen_server.engine_process.messages import OwnerChanged, Pulse, Ready, ToEngine
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.rpc.abilities import NOTHING_CLAIMED
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import spec

FULL = {Priority.HERO: 2.0, Priority.NEAR: 0.0, Priority.CROWD: 0.0, Priority.BATCH: 0.0}


class Process:
    """An engine process with one model, as far as a group uses it."""

    def __init__(self, link: ModelLink) -> None:
        self._link = link

        self.told: list[ToEngine] = []

    def tell(self, message: ToEngine) -> bool:
        self.told.append(message)
        return True

    @property
    def load(self) -> float:
        return self._link.load

    @property
    def asked(self) -> float:
        return self._link.asked

    @property
    def num_sessions(self) -> int:
        return self._link.num_sessions


def engines(count: int, at_work: int | None = None) -> tuple[EngineGroup, list[ModelLink]]:
    """A group, and its links to engine processes that are up. at_work: how many are not spare; None: all."""
    links = [ModelLink(1, "model", lambda outputs: None, lambda: None) for _ in range(count)]
    for link in links:
        assert link.take_ready(Ready(1, FACTS, "CC0-1.0", NOTHING_CLAIMED))
    return EngineGroup(cast(Any, [(Process(link), link) for link in links]), 1 << 16, 0.9, at_work), links


def given(tells: list[tuple[float, float]], opens: int = 1000, tell_every: int = 40) -> Counter[int]:
    """How many sessions each engine is given. tells: load and asked that each reports, per hundred sessions."""
    group, links = engines(len(tells))
    for number in range(opens):
        if number % tell_every == 0:
            for link, (load, asked) in zip(links, tells, strict=True):
                hundreds = link.num_sessions / 100
                link.take_pulse(Pulse(1, 0.0, (StepReport(load=load * hundreds, asked=asked * hundreds),)))
        assert group.submit(Open(spec(SessionKey(1, number)), 1, 0.0)) is None
    return Counter({index: link.num_sessions for index, link in enumerate(links)})


def test_engines_with_equal_asked_get_equal_numbers_despite_unequal_loads() -> None:
    found = given([(0.5, 0.4), (0.3, 0.4)])
    assert max(found.values()) - min(found.values()) <= 100 / 20


def test_slower_engine_is_given_fewer_sessions() -> None:
    found = given([(0.4, 0.4), (0.8, 0.8)])
    assert 1.6 < found[0] / found[1] < 2.4


def test_engines_that_report_no_load_yet_get_equal_numbers() -> None:
    found = given([(0.0, 0.0), (0.0, 0.0)])
    assert found[0] == found[1]


def test_engine_full_for_a_class_gets_none_of_it_while_another_has_room() -> None:
    group, links = engines(2)
    for link, asked, places in zip(links, (0.5, 0.8), (FULL, {}), strict=True):
        link.take_pulse(Pulse(1, 0.0, (StepReport(asked=asked, places=places),)))

    def opened(handle: int, priority: Priority, is_clip: bool = False) -> int:
        """The number of the engine that gets the session."""
        key = SessionKey(1, handle)
        given = replace(spec(key, priority=priority), clip_frames=40 if is_clip else None)
        assert group.submit(Open(given, 1, 0.0)) is None
        return next(number for number, link in enumerate(links) if link.holds(key))

    assert opened(1, Priority.NEAR) == 1, "the other engine is asked for less, but has reported no place for this class"
    assert opened(2, Priority.HERO) == 0
    assert opened(3, Priority.NEAR, is_clip=True) == 0, "clips use what sessions leave"


def full_of_near() -> tuple[EngineGroup, list[ModelLink]]:
    """Two engines that have reported no place for NEAR; one of them has a session."""
    group, links = engines(2)
    assert group.submit(Open(spec(SessionKey(1, 1), priority=Priority.NEAR), 1, 0.0)) is None
    for link in links:
        link.take_pulse(Pulse(1, 0.0, (StepReport(places=FULL),)))
    return group, links


def test_class_for_which_all_engines_are_full_is_refused_by_the_gateway() -> None:
    group, links = full_of_near()
    refusals = [group.submit(Open(spec(SessionKey(2, handle), priority=Priority.NEAR), 1, 0.0)) for handle in (1, 2)]
    assert [each and each.reason for each in refusals] == ["OVERLOADED"] * 2
    assert len({each.retry_after_s for each in refusals if each is not None}) == 2, (
        "clients should not all return together"
    )
    assert sum(link.num_sessions for link in links) == 1
    assert group.submit(Open(spec(SessionKey(2, 3), priority=Priority.HERO), 1, 0.0)) is None
    clip = replace(spec(SessionKey(2, 4), priority=Priority.NEAR), clip_frames=40)
    assert group.submit(Open(clip, 1, 0.0)) is None, "clips use what sessions leave"


def test_place_freed_since_the_last_report_can_be_taken_at_once() -> None:
    group, links = full_of_near()
    asks = Open(spec(SessionKey(2, 1), priority=Priority.NEAR), 1, 0.0)
    group.submit(Close(SessionKey(1, 1), 2, 0.0, CloseReason.CLIENT))
    assert group.submit(asks) is None, "the reports are from before the close"
    for link in links:
        link.take_pulse(Pulse(1, 0.0, (StepReport(places=FULL),)))
    refusal = group.submit(replace(asks, spec=spec(SessionKey(2, 2), priority=Priority.NEAR)))
    assert refusal is not None
    assert refusal.reason == "OVERLOADED"


def test_no_more_sessions_are_given_than_the_last_report_had_places() -> None:
    group, links = engines(2)
    for link in links:
        link.take_pulse(Pulse(1, 0.0, (StepReport(places={Priority.NEAR: 2.5, Priority.CROWD: inf}),)))
    asked = [Open(spec(SessionKey(1, number), num_steps=FACTS.default_steps), 1, 0.0) for number in range(40)]
    assert sum(group.submit(each) is None for each in asked) == 4, "two on each engine; the halves are of no use"
    small = [Open(spec(SessionKey(2, number), num_steps=FACTS.default_steps // 2), 1, 0.0) for number in range(40)]
    assert sum(group.submit(each) is None for each in small) == 2
    crowd = spec(SessionKey(3, 1), priority=Priority.CROWD, num_steps=FACTS.default_steps)
    assert group.submit(Open(crowd, 1, 0.0)) is None


def test_session_with_extra_steps_is_passed_on_if_there_is_a_place() -> None:
    group, links = engines(1)
    links[0].take_pulse(Pulse(1, 0.0, (StepReport(places={Priority.NEAR: 1.0}),)))
    assert group.submit(Open(spec(SessionKey(1, 1), num_steps=FACTS.max_steps), 1, 0.0)) is None


def test_spare_engine_is_given_sessions_only_while_another_is_lost() -> None:
    group, links = engines(2, at_work=1)
    for number in range(3):
        assert group.submit(Open(spec(SessionKey(1, number)), 1, 0.0)) is None
    assert [link.num_sessions for link in links] == [3, 0]
    links[0].take_pulse(Pulse(1, 0.0, (StepReport(places=FULL),)))
    refused = group.submit(Open(spec(SessionKey(1, 3), priority=Priority.NEAR), 1, 0.0))
    assert refused is not None
    assert refused.reason == "OVERLOADED", "the spare engine has no core besides that of the first"
    assert group.free_share == 0.0
    links[0].lose(CloseReason.ENGINE_FAULT, "it died")
    assert group.submit(Open(spec(SessionKey(1, 4), priority=Priority.NEAR), 1, 0.0)) is None
    assert [link.num_sessions for link in links] == [0, 1]
    assert group.free_share > 0.99
    assert links[0].take_ready(Ready(1, FACTS, "CC0-1.0", NOTHING_CLAIMED))
    assert group.submit(Open(spec(SessionKey(1, 5)), 1, 0.0)) is None
    assert [link.num_sessions for link in links] == [1, 1], "sessions stay where they are"


def test_engine_processes_that_are_up_are_told_of_a_changed_owner() -> None:
    links = [ModelLink(3, "model", lambda outputs: None, lambda: None) for _ in range(2)]
    processes = [Process(link) for link in links]
    assert links[0].take_ready(Ready(3, FACTS, "CC0-1.0", NOTHING_CLAIMED))
    group = EngineGroup(cast(Any, list(zip(processes, links, strict=True))), 1 << 16)
    owner = Owner("tenant:studio", 2.0, 50.0)
    group.note_owner(owner)
    assert [process.told for process in processes] == [[OwnerChanged(3, owner)], []]
