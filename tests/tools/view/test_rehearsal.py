"""Rehearsals: everything is said again at its frame, by the ids that the new character has given."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from motiongen_client.errors import InvalidInput
from motiongen_tools.view.rehearsal import Rehearsal, ToldAt
from motiongen_tools.view.room import Room
from motiongen_tools.view.session_file import session_of
from tests.tools.view.conftest import Page

WAYPOINT = {"kind": "waypoint", "frame": 90, "x_m": 1.0, "z_m": 2.0}


def told(at_frame: int, prompt_id: int | None = None, ids: tuple[int, ...] = (), **message: Any) -> ToldAt:
    return ToldAt(at_frame, None, message, prompt_id, ids)


def test_each_edit_is_due_once_and_in_its_order() -> None:
    later, first, second = told(9, op="undo"), told(3, op="clear_constraints"), told(3, op="set_velocity")
    rehearsal = Rehearsal([later, first, told(4, op="pause"), second], 20)
    assert rehearsal.due(2) == []
    assert rehearsal.due(8) == [first, second]
    assert rehearsal.due(8) == []
    assert rehearsal.due(30) == [later]


def test_ids_are_those_of_the_new_character() -> None:
    """Then a refused edit had taken constraint 1; now it is not told, and 1 is the next one's."""
    rehearsal = Rehearsal([], 20)
    add = told(3, None, (2,), op="add_constraints")
    rehearsal.told(add, SimpleNamespace(prompt_id=None, constraint_ids=(1,)))  # type: ignore[arg-type]
    rehearsal.told(told(4, 5, op="set_prompt"), SimpleNamespace(prompt_id=2, constraint_ids=()))  # type: ignore[arg-type]
    assert rehearsal.renumbered({"op": "remove_constraints", "constraint_ids": [2, 9]})["constraint_ids"] == [1, 9]
    assert rehearsal.renumbered({"op": "replace_constraint", "constraint_id": 2})["constraint_id"] == 1
    assert rehearsal.renumbered({"op": "remove_prompts", "prompt_ids": [5]})["prompt_ids"] == [2]
    assert rehearsal.renumbered({"op": "set_prompt", "prompt_id": 5})["prompt_id"] == 2


async def test_a_character_is_told_again_what_another_was(page: Page, room: Room) -> None:
    await page.ask(op="add", text="a person stands", steps=4)
    await page.ask(op="set_prompt", character=1, text="a person runs")
    await page.ask(op="add_constraints", character=1, constraints=[WAYPOINT])
    await page.until(lambda: [e["state"] for e in page.last("character")["edits"]] == ["accepted", "accepted"])
    answer = await page.ask(op="again", character=1, changes={"steps": 8, "name": "eight"})
    (number,) = answer["numbers"]
    again = room.character(number)
    assert again.name == "eight"
    assert again.options.denoise_steps == 8
    assert again.options.seed == room.character(1).session.opened.seed
    await page.until(lambda: len(again.edits.entries) == 2)
    assert [entry.message["op"] for entry in again.edits.entries] == ["set_prompt", "add_constraints"]
    await page.until(lambda: again.session.is_paused)
    assert again.failure == ""


async def test_only_what_an_opening_may_say_can_be_changed(page: Page, room: Room) -> None:
    await page.ask(op="add", text="a person stands")
    with pytest.raises(InvalidInput, match="only text"):
        await room.again(session_of(room.character(1)), {"colour": "red"})
    answer = await page.ask(op="again", character=1, changes=[])
    assert "an object" in answer["error"]


async def test_what_cannot_be_said_again_is_told(room: Room) -> None:
    await room.add({"text": "a person stands"})
    recorded = session_of(room.character(1))
    number = await room.again(type(recorded)(recorded.opening, 50, (told(0, op="dance"),)), {})
    room.tick()
    assert "frame 0 cannot be said again" in room.character(number).failure
