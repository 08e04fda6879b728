"""The queue of edits: what waits, what is settled, what has landed and been seen."""

import math

import numpy as np
import pytest

from motiongen_ardy.locomotion.velocity import SLOWING_FRAMES
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.edits import EditQueue, PendingEdit, edited
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.session.velocity import Velocity
from motiongen_server.engine.types import Code, Direction, EventRefused, Gait, SessionKey, SetVelocity
from tests.server.engine.stage import prompt


def _edit(seq: int, dirty_from: int = 0) -> PendingEdit:
    return PendingEdit(seq, "prompts", float(seq), dirty_from)


def _queue(*edits: PendingEdit) -> EditQueue:
    queue = EditQueue(3)
    for edit in edits:
        queue.add(edit)
    return queue


def test_edits_put_back_precede_later_ones_and_may_start_at_once() -> None:
    queue = _queue(_edit(1), _edit(2))
    taken = queue.take()
    queue.not_before = 7.0
    queue.add(_edit(3))
    queue.put_back(taken)
    assert [edit.event_seq for edit in queue.waiting] == [1, 2, 3]
    assert queue.not_before == -math.inf


def test_full_queue_refuses_further_edits() -> None:
    queue = _queue(_edit(1), _edit(2))
    queue.require_room()
    queue.add(_edit(3))
    with pytest.raises(EventRefused) as refused:
        queue.require_room()
    assert (refused.value.code, refused.value.reason) == (Code.RESOURCE_EXHAUSTED, "TOO_MANY_PENDING_EVENTS")
    queue.take()
    queue.require_room()


def test_edits_of_frames_that_no_window_has_touched_are_settled() -> None:
    queue = _queue(_edit(1, 39), _edit(2, 40), _edit(3, 100))
    assert queue.settle(0) == []
    assert [edit.event_seq for edit in queue.settle(40)] == [2, 3]
    assert [edit.event_seq for edit in queue.waiting] == [1]
    assert queue.settle(40) == []


def test_edit_takes_effect_where_its_plan_starts_or_at_its_own_later_frame() -> None:
    queue = _queue()
    assert [frame for _, frame in queue.landed([_edit(1, 10), _edit(2, 30)], 20, 20)] == [20, 30]


def test_edit_counts_as_seen_once_and_never_if_replaced_before() -> None:
    queue = _queue()
    queue.landed([_edit(1, 10), _edit(2, 35)], 20, 20)
    assert queue.seen(20) == []
    assert [edit.event_seq for edit in queue.seen(30)] == [1]
    queue.landed([_edit(3)], 32, 30)
    assert [edit.event_seq for edit in queue.seen(100)] == [3]
    assert queue.seen(200) == []


def test_hold_time_begins_with_the_first_window_that_obeys_the_newest_velocity() -> None:
    old, new = Velocity(1.0, 0.0, None, 40), Velocity(2.0, 0.0, None, 40)
    held = Conditions(velocity=new)
    assert held.with_velocity_landed(None, 50) is held
    assert held.with_velocity_landed(old, 50) is held
    landed = held.with_velocity_landed(new, 50)
    assert landed.velocity == Velocity(2.0, 0.0, None, 40, steers_from=50)
    assert landed.with_velocity_landed(landed.velocity, 90) is landed
    assert landed.without_past(89 + SLOWING_FRAMES) is landed
    assert landed.without_past(90 + SLOWING_FRAMES).velocity is None


@pytest.mark.parametrize(("keep_prompt", "dirty_from", "prolongs"), [(False, 140, True), (True, 120, False)])
def test_repeated_velocity_prolongs_only_if_the_prompt_stays_the_same(
    keep_prompt: bool, dirty_from: int, prolongs: bool
) -> None:
    walk = Gait("walk", "a person walks", 0.0, Direction.FORWARD, np.ones(2, np.float32))
    held = Conditions((prompt(5, 1, 0),), velocity=Velocity(1.0, 0.0, None, 40, steers_from=100), gait=walk)
    event = SetVelocity(SessionKey(1, 1), 2, 0.0, 1.0, 0.0, None, 40, keep_prompt)
    result = edited(held, event, floor=120, reach=40, config=EngineConfig(), anchor=_nowhere, gaits=(walk,))
    assert (result.kind, result.dirty_from, result.prolongs) == ("velocity", dirty_from, prolongs)


def _nowhere() -> Anchor:
    raise AssertionError("nothing here is placed")
