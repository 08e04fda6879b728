import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.session.conditions import Conditions, edit_constraints, edit_prompts
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.types import (
    Code,
    EventRefused,
    Prompt,
    RootTrajectory,
    SessionKey,
    SetConstraints,
    SetPrompts,
    Waypoint,
)
from tests.server.engine.stage import prompt

KEY = SessionKey(1, 1)


def here() -> Anchor:
    """No constraint of these tests asks from where a character is."""
    raise AssertionError


def _prompts(*upsert: Prompt, remove: tuple[int, ...] = ()) -> SetPrompts:
    return SetPrompts(KEY, 1, 0.0, upsert, remove)


def _constraints(
    *upsert: Waypoint | RootTrajectory, remove: tuple[int, ...] = (), clear: bool = False
) -> SetConstraints:
    return SetConstraints(KEY, 1, 0.0, upsert, remove, clear)


def _marker(prompt: Prompt | None) -> int:
    return -1 if prompt is None else int(prompt.embedding[0])


def test_the_span_that_starts_last_holds() -> None:
    held = Conditions((prompt(1, 1, 0), prompt(2, 2, 50, 60), prompt(3, 3, 50)))
    assert [_marker(held.prompt_at(frame)) for frame in (0, 49, 50, 60)] == [1, 1, 3, 3]
    held = Conditions((prompt(1, 1, 0), prompt(3, 3, 40), prompt(2, 2, 50, 60)))
    assert [_marker(held.prompt_at(frame)) for frame in (39, 40, 50, 59, 60)] == [1, 3, 2, 2, 3]


def test_no_prompt_holds_between_spans() -> None:
    held = Conditions((prompt(1, 1, 10, 20),))
    assert [_marker(held.prompt_at(frame)) for frame in (9, 10, 19, 20)] == [-1, 1, 1, -1]
    assert held.prompt_change_after(0, 100) == 10
    assert held.prompt_change_after(10, 100) == 20
    assert held.prompt_change_after(20, 100) == 100


def test_a_prompt_that_holds_goes_on_until_the_one_in_its_place_begins() -> None:
    held = Conditions((prompt(1, 1, 0), prompt(9, 2, 90)))
    later, changed = edit_prompts(held, _prompts(prompt(2, 1, 50)), floor=30, limit=8)
    assert changed == 50
    assert [_marker(later.prompt_at(frame)) for frame in (30, 49, 50, 89, 90)] == [1, 1, 2, 2, 9]
    again, changed = edit_prompts(later, _prompts(prompt(3, 1, 70)), floor=40, limit=8)
    assert changed == 50
    assert [_marker(again.prompt_at(frame)) for frame in (40, 69, 70)] == [1, 1, 3]
    gone, changed = edit_prompts(again, _prompts(remove=(1,)), floor=45, limit=8)
    assert changed == 45
    assert [_marker(gone.prompt_at(frame)) for frame in (45, 70, 90)] == [-1, -1, 9]


def test_before_the_frame_that_an_edit_counts_from_all_holds_that_held() -> None:
    held = Conditions((prompt(1, 1, 0),))
    for marker, floor in ((2, 30), (3, 50), (4, 45)):
        held, changed = edit_prompts(held, _prompts(prompt(marker)), floor, limit=8)
        assert changed == floor
    assert [_marker(held.prompt_at(frame)) for frame in (0, 29, 30, 44, 45, 50, 90)] == [1, 1, 2, 2, 4, 4, 4]
    later, _ = edit_prompts(held, _prompts(prompt(5, 1, 60)), 40, limit=8)
    assert [_marker(later.prompt_at(frame)) for frame in (29, 30, 44, 45, 59, 60)] == [1, 2, 2, 2, 2, 5]


def test_a_prompt_that_does_not_hold_yet_or_ends_before_leaves_nothing() -> None:
    waiting = Conditions((prompt(1, 1, 60),))
    moved, _ = edit_prompts(waiting, _prompts(prompt(1, 1, 80)), floor=30, limit=8)
    assert [_marker(moved.prompt_at(frame)) for frame in (30, 60, 79, 80)] == [-1, -1, -1, 1]
    ending = Conditions((prompt(1, 1, 0, 40),))
    after, _ = edit_prompts(ending, _prompts(prompt(2, 1, 50)), floor=30, limit=1)
    assert [_marker(after.prompt_at(frame)) for frame in (30, 39, 40, 50)] == [1, 1, -1, 2]


def test_of_equal_starts_the_one_set_last_holds_also_where_one_is_left_over() -> None:
    held, _ = edit_prompts(Conditions((prompt(1, 1, 0), prompt(2, 2, 50))), _prompts(prompt(3, 1, 50)), 10, 8)
    assert [_marker(held.prompt_at(frame)) for frame in (20, 50)] == [1, 3]
    held, _ = edit_prompts(held, _prompts(prompt(4, 3, 200)), 12, 8)
    assert [_marker(held.prompt_at(frame)) for frame in (20, 50)] == [1, 3]


SPANS = st.builds(
    lambda marker, prompt_id, start, length: prompt(
        marker, prompt_id, start, None if length is None else start + length
    ),
    st.integers(0, 3),
    st.integers(1, 4),
    st.integers(0, 60),
    st.none() | st.integers(1, 40),
)


@given(st.lists(SPANS, max_size=4), st.lists(SPANS, max_size=3), st.integers(0, 50))
def test_an_edit_names_the_first_frame_that_it_changes(before: list[Prompt], edit: list[Prompt], floor: int) -> None:
    held = Conditions(tuple({span.prompt_id: span for span in before}.values()))
    allowed = [span for span in edit if span.end_frame is None or span.end_frame > floor]
    edited, dirty_from = edit_prompts(held, _prompts(*allowed), floor, limit=16)
    changed = [
        frame for frame in range(floor, 120) if _marker(held.prompt_at(frame)) != _marker(edited.prompt_at(frame))
    ]
    assert dirty_from == (changed[0] if changed else None)


def test_what_is_left_of_a_prompt_wins_over_one_of_the_same_start_that_was_set_before_it() -> None:
    held = Conditions((prompt(0, 1, 0), prompt(1, 2, 0)))
    edited, _ = edit_prompts(held, _prompts(prompt(3, 2, 0)), 10, 8)
    assert [_marker(edited.prompt_at(frame)) for frame in (0, 9, 10)] == [1, 1, 3]


@given(st.lists(SPANS, max_size=4), st.lists(st.tuples(SPANS, st.integers(0, 50)), max_size=5))
def test_an_edit_leaves_what_holds_before_it(before: list[Prompt], edits: list[tuple[Prompt, int]]) -> None:
    held = Conditions(tuple({span.prompt_id: span for span in before}.values()))
    for span, floor in edits:
        if span.end_frame is None or span.end_frame > floor:
            edited, _ = edit_prompts(held, _prompts(span), floor, limit=16)
            assert [_marker(edited.prompt_at(at)) for at in range(floor)] == [
                _marker(held.prompt_at(at)) for at in range(floor)
            ]
            held = edited


@given(st.lists(SPANS, max_size=4), st.integers(0, 60))
def test_a_change_of_prompt_is_found_where_it_is(spans: list[Prompt], frame: int) -> None:
    held = Conditions(tuple(spans))
    same = [_marker(held.prompt_at(other)) == _marker(held.prompt_at(frame)) for other in range(frame, 101)]
    assert held.prompt_change_after(frame, 101) == (frame + same.index(False) if False in same else 101)


def test_a_prompt_for_now_beats_one_that_was_to_start_before() -> None:
    held = Conditions((prompt(1, 1, 0), prompt(2, 2, 100)))
    edited, dirty_from = edit_prompts(held, _prompts(prompt(3, 3)), 150, limit=16)
    assert dirty_from == 150
    assert _marker(edited.prompt_at(151)) == 3
    edited, _ = edit_prompts(held, _prompts(prompt(4, 4, 20)), 150, limit=16)
    assert _marker(edited.prompt_at(151)) == 4


def test_setting_the_same_prompt_again_changes_nothing() -> None:
    held = Conditions((prompt(1),))
    assert edit_prompts(held, _prompts(prompt(1)), 30, limit=16)[1] is None


def test_refused_edits_say_what_is_allowed() -> None:
    held = Conditions((prompt(1, 7),), (Waypoint(5, 90, 0.0, 0.0),))
    cases = [
        (lambda: edit_prompts(held, _prompts(remove=(8,)), 0, 16), Code.NOT_FOUND, "UNKNOWN_PROMPT", "7"),
        (
            lambda: edit_prompts(held, _prompts(prompt(2, 2, 0, 20)), 20, 16),
            Code.FAILED_PRECONDITION,
            "FRAME_COMMITTED",
            "from 20",
        ),
        (lambda: edit_prompts(held, _prompts(prompt(2, 2)), 0, 1), Code.RESOURCE_EXHAUSTED, "TOO_MANY_PROMPTS", "1"),
        (
            lambda: edit_constraints(held, _constraints(remove=(6,)), 0, 9, 99, here),
            Code.NOT_FOUND,
            "UNKNOWN_CONSTRAINT",
            "5",
        ),
        (
            lambda: edit_constraints(held, _constraints(Waypoint(6, 19, 0.0, 0.0)), 20, 9, 99, here),
            Code.FAILED_PRECONDITION,
            "FRAME_COMMITTED",
            "from 20",
        ),
        (
            lambda: edit_constraints(held, _constraints(Waypoint(6, 20, 0.0, 0.0)), 20, 1, 99, here),
            Code.RESOURCE_EXHAUSTED,
            "TOO_MANY_CONSTRAINTS",
            "1",
        ),
        (
            lambda: edit_constraints(held, _constraints(remove=(5,), clear=True), 0, 9, 99, here),
            Code.NOT_FOUND,
            "UNKNOWN_C",
            "non",
        ),
    ]
    for edit, code, reason, allowed in cases:
        with pytest.raises(EventRefused) as caught:
            edit()
        outcome = caught.value.outcome(KEY, 3)
        assert outcome.code is code
        assert outcome.reason.startswith(reason)
        assert allowed in outcome.allowed
        assert outcome.field.startswith("edit_")
        assert outcome.event_seq == 3


def test_an_edit_of_constraints_names_all_that_came_and_went() -> None:
    old = Waypoint(1, 50, 0.0, 0.0)
    path = RootTrajectory(2, 60, np.zeros((10, 2), np.float32))
    new = Waypoint(1, 80, 1.0, 0.0)
    edited, changed, _ = edit_constraints(Conditions((), (old, path)), _constraints(new, remove=(2,)), 10, 9, 99, here)
    assert edited.constraints == (new,)
    assert set(changed) == {old, path, new}
    edited, changed, _ = edit_constraints(Conditions((), (old, path)), _constraints(clear=True), 10, 9, 99, here)
    assert (edited.constraints, changed) == ((), (old, path))


def test_constraints_are_seen_from_their_first_to_their_last_frame() -> None:
    path = RootTrajectory(2, 60, np.zeros((10, 2), np.float32))
    held = Conditions((), (path,))
    assert held.constraints_within(0, 60) == ()
    assert held.constraints_within(0, 61) == (path,)
    assert held.constraints_within(69, 100) == (path,)
    assert held.constraints_within(70, 100) == ()


def test_what_has_passed_is_forgotten() -> None:
    held = Conditions((prompt(1, 1, 0, 50), prompt(2, 2, 10)), (Waypoint(1, 49, 0.0, 0.0), Waypoint(2, 50, 0.0, 0.0)))
    later = held.without_past(50)
    assert [span.prompt_id for span in later.prompts] == [2]
    assert [item.constraint_id for item in later.constraints] == [2]
