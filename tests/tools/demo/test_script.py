"""The script as data: in order, within its length, and with goals that people could reach."""

from __future__ import annotations

import pytest

from motiongen_tools.demo.script import CAST, STORY, STORY_S, Circle, GoTo, Move, Reach, Role, Say, Turn


@pytest.mark.parametrize("role", CAST, ids=lambda role: role.name)
def test_cues_are_in_order_and_their_actions_end_within_the_story(role: Role) -> None:
    times = [cue.at_s for cue in role.cues]
    assert times == sorted(set(times))
    for cue in role.cues:
        for action in cue.actions:
            match action:
                case GoTo(in_s=lasts) | Turn(in_s=lasts) | Reach(in_s=lasts) | Move(seconds=lasts):
                    pass
                case Circle(seconds=seconds, begins_s=begins):
                    lasts = begins + seconds
                case Say():
                    lasts = 1.0  # to be seen
            assert cue.at_s + lasts <= STORY_S


def test_names_of_roles_are_unique_and_fit_for_file_names() -> None:
    assert len({role.name for role in CAST}) == len(CAST)
    assert all(role.name.isidentifier() for role in CAST)


def test_waypoints_can_be_reached_at_a_walk() -> None:
    """1.2 m/s, less a second for half a turn."""
    places = [action for cue in STORY.cues for action in cue.actions if isinstance(action, GoTo)]
    assert all(place.metres <= 1.2 * (place.in_s - abs(place.turn_deg) / 180) for place in places)
    assert any(place.turn_deg == 0 for place in places)
    assert any(abs(place.turn_deg) >= 45 for place in places)


def test_the_story_stands_walks_turns_stops_and_waves() -> None:
    said = [STORY.prompt, *(action.text for cue in STORY.cues for action in cue.actions if isinstance(action, Say))]
    order = [next(number for number, text in enumerate(said) if word in text) for word in ("stands", "walks", "turns")]
    assert order == sorted(order)
    assert "waves" in said[-1]
    assert any(isinstance(action, Move) and action.speed_mps == 0 for cue in STORY.cues for action in cue.actions)
