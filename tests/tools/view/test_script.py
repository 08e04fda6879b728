"""What is in force after edits were accepted, and the edits that undo each of them."""

from __future__ import annotations

from typing import Any

from motiongen_client import ConstraintReached
from motiongen_client.types import Placement
from motiongen_tools.view.script import Script

WAYPOINT = {"kind": "waypoint", "frame": 90, "x_m": 1.0, "z_m": 2.0}
OTHER = {"kind": "heading", "frame": 120, "heading_rad": 1.0}


def prompt(text: str, **more: int) -> dict[str, Any]:
    return {"op": "set_prompt", "text": text, **more}


def add(*specs: dict[str, Any]) -> dict[str, Any]:
    return {"op": "add_constraints", "constraints": list(specs)}


def spans_of(script: Script) -> list[tuple[str, int, int | None]]:
    return [(span.message["text"], span.start, span.end) for span in script.spans]


def test_an_immediate_prompt_ends_the_one_before() -> None:
    script = Script()
    script.take(prompt("stand"), 0, 1, (), 0)
    script.take(prompt("walk"), 40, 1, (), 30)
    assert spans_of(script) == [("stand", 0, 40), ("walk", 40, None)]


def test_a_scheduled_prompt_can_be_moved_by_its_id() -> None:
    script = Script()
    script.take(prompt("stand"), 0, 1, (), 0)
    script.take(prompt("wave", frame=100, end_frame=140), 100, 2, (), 30)
    moved = prompt("wave", frame=120, end_frame=180, prompt_id=2)
    assert script.inverse(moved, 2, ()) == [prompt("wave", frame=100, end_frame=140, prompt_id=2)]
    script.take(moved, 120, 2, (), 40)
    assert spans_of(script) == [("stand", 0, None), ("wave", 120, 180)]


def test_each_prompt_edit_has_an_inverse() -> None:
    script = Script()
    assert script.inverse(prompt("stand"), 1, ()) == [{"op": "remove_prompts", "prompt_ids": [1]}]
    script.take(prompt("stand"), 0, 1, (), 0)
    assert script.inverse(prompt("walk"), 1, ()) == [prompt("stand")]
    later = prompt("wave", frame=100)
    assert script.inverse(later, 2, ()) == [{"op": "remove_prompts", "prompt_ids": [2]}]
    script.take(later, 100, 2, (), 10)
    removal = {"op": "remove_prompts", "prompt_ids": [2]}
    assert script.inverse(removal, None, ()) == [prompt("wave", frame=100, prompt_id=2)]
    script.take(removal, None, None, (), 20)
    assert spans_of(script) == [("stand", 0, None)]


def test_each_constraint_edit_has_an_inverse() -> None:
    script = Script()
    assert script.inverse(add(WAYPOINT), None, (1,)) == [{"op": "remove_constraints", "constraint_ids": [1]}]
    script.take(add(WAYPOINT, OTHER), 50, None, (1, 2), 40)
    moved = {"op": "replace_constraint", "constraint_id": 1, "constraint": OTHER}
    back = {"op": "replace_constraint", "constraint_id": 1, "constraint": WAYPOINT}
    assert script.inverse(moved, None, (1,)) == [back]
    assert script.inverse({"op": "remove_constraints", "constraint_ids": [2]}, None, ()) == [add(OTHER)]
    clear = {"op": "clear_constraints"}
    assert script.inverse(clear, None, ()) == [add(WAYPOINT, OTHER)]
    script.take(clear, 60, None, (), 50)
    assert [target.is_removed for target in script.targets.values()] == [True, True]
    assert script.inverse(clear, None, ()) == []
    assert script.inverse({"op": "set_velocity", "x_mps": 1, "z_mps": 0}, None, ()) == []


def test_the_state_of_a_target_is_shown() -> None:
    script = Script()
    script.take(add(WAYPOINT, OTHER), 50, None, (1, 2), 40)
    script.note_reached(ConstraintReached(1, True, 90, 0.04, None))
    script.note_reached(ConstraintReached(9, True, 90, 0.04, None))
    first, second = script.shown()["targets"]
    assert (first["state"], first["position_error_m"], first["first"]) == ("met", 0.04, 90)
    assert (second["state"], second["effective_frame"]) == ("waiting", 50)
    script.take({"op": "clear_constraints"}, 60, None, (), 50)
    assert [each["state"] for each in script.shown()["targets"]] == ["met", "removed"]


def test_a_target_placed_by_the_server_is_shown_at_its_placement() -> None:
    script = Script()
    anywhere = {"kind": "waypoint", "frame": 0, "x_m": 1.0, "z_m": 2.0, "at_any_frame": True}
    script.take(add(anywhere), 50, None, (1,), 40)
    assert script.shown()["targets"][0]["first"] is None
    script.note_placements([Placement(1, 50, 130, 90, 50, 0.0, 0.0, 0.0), Placement(7, 1, 1, 1, 1, 0.0, 0.0, 0.0)])
    shown = script.shown()["targets"][0]
    assert (shown["first"], shown["last"], shown["arrival"]) == (50, 130, 90)


def test_targets_that_passed_while_the_connection_was_lost_are_removed() -> None:
    """The session that continues is not sent them, and reports nothing about them."""
    script = Script()
    anywhere = {"kind": "waypoint", "frame": 0, "x_m": 1.0, "z_m": 2.0, "at_any_frame": True}
    script.take(add(WAYPOINT, OTHER, anywhere, anywhere), 50, None, (1, 2, 3, 4), 40)
    script.note_placements([Placement(3, 50, 99, 90, 50, 0.0, 0.0, 0.0)])
    script.note_reopened(100)
    states = [target["state"] for target in script.shown()["targets"]]
    assert states == ["removed", "waiting", "removed", "waiting"]
