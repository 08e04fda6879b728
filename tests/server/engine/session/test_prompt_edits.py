import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.prompt_edits import edit_prompts
from motiongen_server.engine.types import Code, EventRefused, Prompt, SessionKey, SetPrompts
from tests.server.engine.session.spans import SPANS, marker
from tests.server.engine.stage import Stage, prompt

KEY = SessionKey(1, 1)


def _prompts(*upsert: Prompt, remove: tuple[int, ...] = ()) -> SetPrompts:
    return SetPrompts(KEY, 1, 0.0, upsert, remove)


def test_prompt_in_force_stays_until_its_replacement_begins() -> None:
    held = Conditions((prompt(1, 1, 0), prompt(9, 2, 90)))
    later, changed = edit_prompts(held, _prompts(prompt(2, 1, 50)), floor=30, limit=8)
    assert changed == 50
    assert [marker(later.prompt_at(frame)) for frame in (30, 49, 50, 89, 90)] == [1, 1, 2, 2, 9]
    again, changed = edit_prompts(later, _prompts(prompt(3, 1, 70)), floor=40, limit=8)
    assert changed == 50
    assert [marker(again.prompt_at(frame)) for frame in (40, 69, 70)] == [1, 1, 3]
    gone, changed = edit_prompts(again, _prompts(remove=(1,)), floor=45, limit=8)
    assert changed == 45
    assert [marker(gone.prompt_at(frame)) for frame in (45, 70, 90)] == [-1, -1, 9]


def test_prompts_before_the_frame_that_an_edit_counts_from_stay_in_force() -> None:
    held = Conditions((prompt(1, 1, 0),))
    for text, floor in ((2, 30), (3, 50), (4, 45)):
        held, changed = edit_prompts(held, _prompts(prompt(text)), floor, limit=8)
        assert changed == floor
    assert [marker(held.prompt_at(frame)) for frame in (0, 29, 30, 44, 45, 50, 90)] == [1, 1, 2, 2, 4, 4, 4]
    later, _ = edit_prompts(held, _prompts(prompt(5, 1, 60)), 40, limit=8)
    assert [marker(later.prompt_at(frame)) for frame in (29, 30, 44, 45, 59, 60)] == [1, 2, 2, 2, 2, 5]


def test_replaced_prompt_leaves_nothing_if_it_has_not_begun_or_ends_before() -> None:
    waiting = Conditions((prompt(1, 1, 60),))
    moved, _ = edit_prompts(waiting, _prompts(prompt(1, 1, 80)), floor=30, limit=8)
    assert [marker(moved.prompt_at(frame)) for frame in (30, 60, 79, 80)] == [-1, -1, -1, 1]
    ending = Conditions((prompt(1, 1, 0, 40),))
    after, _ = edit_prompts(ending, _prompts(prompt(2, 1, 50)), floor=30, limit=1)
    assert [marker(after.prompt_at(frame)) for frame in (30, 39, 40, 50)] == [1, 1, -1, 2]


def test_of_prompts_with_equal_starts_the_one_set_last_is_in_force() -> None:
    held, _ = edit_prompts(Conditions((prompt(1, 1, 0), prompt(2, 2, 50))), _prompts(prompt(3, 1, 50)), 10, 8)
    assert [marker(held.prompt_at(frame)) for frame in (20, 50)] == [1, 3]
    held, _ = edit_prompts(held, _prompts(prompt(4, 3, 200)), 12, 8)
    assert [marker(held.prompt_at(frame)) for frame in (20, 50)] == [1, 3]


@given(st.lists(SPANS, max_size=4), st.lists(SPANS, max_size=3), st.integers(0, 50))
def test_edit_returns_the_first_frame_that_it_changes(before: list[Prompt], edit: list[Prompt], floor: int) -> None:
    held = Conditions(tuple({span.prompt_id: span for span in before}.values()))
    allowed = [span for span in edit if span.end_frame is None or span.end_frame > floor]
    edited, dirty_from = edit_prompts(held, _prompts(*allowed), floor, limit=16)
    changed = [frame for frame in range(floor, 120) if marker(held.prompt_at(frame)) != marker(edited.prompt_at(frame))]
    assert dirty_from == (changed[0] if changed else None)


def test_rest_of_a_replaced_prompt_outranks_an_equal_start_set_earlier() -> None:
    held = Conditions((prompt(0, 1, 0), prompt(1, 2, 0)))
    edited, _ = edit_prompts(held, _prompts(prompt(3, 2, 0)), 10, 8)
    assert [marker(edited.prompt_at(frame)) for frame in (0, 9, 10)] == [1, 1, 3]


@given(
    st.lists(SPANS, max_size=4),
    st.lists(st.tuples(st.integers(0, 50), SPANS | st.integers(1, 4)), max_size=5),
)
def test_edit_changes_no_frame_before_its_floor(before: list[Prompt], edits: list[tuple[int, Prompt | int]]) -> None:
    held = Conditions(tuple({span.prompt_id: span for span in before}.values()))
    for floor, edit in edits:
        event = _prompts(remove=(edit,)) if isinstance(edit, int) else _prompts(edit)
        try:
            edited, _ = edit_prompts(held, event, floor, limit=16)
        except EventRefused:
            continue
        assert [marker(edited.prompt_at(at)) for at in range(floor)] == [
            marker(held.prompt_at(at)) for at in range(floor)
        ]
        held = edited


def test_newly_set_prompt_outranks_one_that_has_already_started() -> None:
    held = Conditions((prompt(1, 1, 0), prompt(2, 2, 100)))
    edited, dirty_from = edit_prompts(held, _prompts(prompt(3, 3)), 150, limit=16)
    assert dirty_from == 150
    assert marker(edited.prompt_at(151)) == 3
    edited, _ = edit_prompts(held, _prompts(prompt(4, 4, 20)), 150, limit=16)
    assert marker(edited.prompt_at(151)) == 4


def test_setting_the_same_prompt_again_changes_nothing() -> None:
    held = Conditions((prompt(1),))
    assert edit_prompts(held, _prompts(prompt(1)), 30, limit=16)[1] is None


def test_end_frame_named_by_a_refusal_is_accepted() -> None:
    with pytest.raises(EventRefused) as refused:
        edit_prompts(Conditions(), _prompts(prompt(2, 2, 0, 20)), floor=20, limit=16)
    least = int(refused.value.allowed.split()[3])
    _, changed = edit_prompts(Conditions(), _prompts(prompt(2, 2, 0, least)), floor=20, limit=16)
    assert changed == 20


@pytest.mark.parametrize(
    ("event", "floor", "limit", "refusal", "allowed"),
    [
        (_prompts(remove=(8,)), 0, 16, (Code.NOT_FOUND, "UNKNOWN_PROMPT", "edit_prompts.remove[0]"), "7"),
        (
            _prompts(prompt(2, 2, 0, 20)),
            20,
            16,
            (Code.FAILED_PRECONDITION, "FRAME_COMMITTED", "edit_prompts.upsert[0].end_frame"),
            "from 21",
        ),
        (_prompts(prompt(2, 2)), 0, 1, (Code.RESOURCE_EXHAUSTED, "TOO_MANY_PROMPTS", "edit_prompts.upsert"), "1"),
    ],
)
def test_a_refused_edit_says_what_is_allowed(
    event: SetPrompts, floor: int, limit: int, refusal: tuple[Code, str, str], allowed: str
) -> None:
    with pytest.raises(EventRefused) as caught:
        edit_prompts(Conditions((prompt(1, 7),)), event, floor, limit)
    outcome = caught.value.outcome(KEY, 3)
    assert (outcome.code, outcome.reason, outcome.field) == refusal
    assert allowed in outcome.allowed
    assert outcome.event_seq == 3


@given(st.lists(SPANS, max_size=5))
def test_open_sets_prompts_as_one_edit_would(spans: list[Prompt]) -> None:
    stage = Stage()
    viewer = stage.open(prompts=tuple(spans))
    stage.step()
    opened = stage.engine.sessions[viewer.key].conditions
    edited, _ = edit_prompts(Conditions(), _prompts(*spans), floor=0, limit=8)
    assert [marker(opened.prompt_at(frame)) for frame in range(110)] == [
        marker(edited.prompt_at(frame)) for frame in range(110)
    ]


def test_removed_prompt_is_unknown_and_no_longer_counts() -> None:
    held, _ = edit_prompts(Conditions((prompt(1, 1, 0), prompt(2, 2, 0))), _prompts(remove=(1,)), 30, 2)
    with pytest.raises(EventRefused, match="prompt 1 is not set") as caught:
        edit_prompts(held, _prompts(remove=(1,)), 35, 2)
    assert caught.value.allowed == "the ids that are set: 2"
    edit_prompts(held, _prompts(prompt(3, 3)), 30, limit=2)  # and it no longer counts towards the limit
