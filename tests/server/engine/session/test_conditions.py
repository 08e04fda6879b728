import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.types import Prompt, RootTrajectory, Waypoint
from tests.server.engine.session.spans import SPANS, marker
from tests.server.engine.stage import prompt


def test_of_overlapping_prompt_spans_the_last_to_start_is_in_force() -> None:
    held = Conditions((prompt(1, 1, 0), prompt(2, 2, 50, 60), prompt(3, 3, 50)))
    assert [marker(held.prompt_at(frame)) for frame in (0, 49, 50, 60)] == [1, 1, 3, 3]
    held = Conditions((prompt(1, 1, 0), prompt(3, 3, 40), prompt(2, 2, 50, 60)))
    assert [marker(held.prompt_at(frame)) for frame in (39, 40, 50, 59, 60)] == [1, 3, 2, 2, 3]


def test_no_prompt_is_in_force_between_spans() -> None:
    held = Conditions((prompt(1, 1, 10, 20),))
    assert [marker(held.prompt_at(frame)) for frame in (9, 10, 19, 20)] == [-1, 1, 1, -1]
    assert held.prompt_change_after(0, 100) == 10
    assert held.prompt_change_after(10, 100) == 20
    assert held.prompt_change_after(20, 100) == 100


@given(st.lists(SPANS, max_size=4), st.integers(0, 60))
def test_prompt_change_after_gives_the_first_frame_with_another_prompt(spans: list[Prompt], frame: int) -> None:
    held = Conditions(tuple(spans))
    same = [marker(held.prompt_at(other)) == marker(held.prompt_at(frame)) for other in range(frame, 101)]
    assert held.prompt_change_after(frame, 101) == (frame + same.index(False) if False in same else 101)


def test_constraints_within_a_range_are_those_with_a_frame_in_it() -> None:
    path = RootTrajectory(2, 60, np.zeros((10, 2), np.float32))
    held = Conditions((), (path,))
    assert held.constraints_within(0, 60) == ()
    assert held.constraints_within(0, 61) == (path,)
    assert held.constraints_within(69, 100) == (path,)
    assert held.constraints_within(70, 100) == ()


def test_past_prompts_and_constraints_are_dropped() -> None:
    held = Conditions((prompt(1, 1, 0, 50), prompt(2, 2, 10)), (Waypoint(1, 49, 0.0, 0.0), Waypoint(2, 50, 0.0, 0.0)))
    later = held.without_past(50)
    assert [span.prompt_id for span in later.prompts] == [2]
    assert [item.constraint_id for item in later.constraints] == [2]
