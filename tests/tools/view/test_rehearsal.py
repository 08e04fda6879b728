"""Rehearsals: every edit is repeated at its frame, with the ids of the new character."""

from __future__ import annotations

import asyncio
import itertools
from types import SimpleNamespace
from typing import Any

import pytest

from motiongen_client.errors import InvalidInput
from motiongen_tools.view.bridge import Bridge
from motiongen_tools.view.character import Character
from motiongen_tools.view.rehearsal import Rehearsal, ToldAt
from motiongen_tools.view.room import IDLE_S, Room
from motiongen_tools.view.session_file import SessionFile, session_of
from tests.client.fake_server import FakeServer
from tests.tools.view.conftest import Page
from tests.waiting import LIMIT_S

WAYPOINT = {"kind": "waypoint", "frame": 90, "x_m": 1.0, "z_m": 2.0}
LIMB = {"kind": "joint_targets", "frame": 90, "positions_m": [[0, 1, 0]]}


def told(at_frame: int, prompt_id: int | None = None, ids: tuple[int, ...] = (), **message: Any) -> ToldAt:
    return ToldAt(at_frame, None, message, prompt_id, ids)


def test_each_edit_is_due_once_and_in_order() -> None:
    later, first, second = told(9, op="undo"), told(3, op="clear_constraints"), told(3, op="set_velocity")
    rehearsal = Rehearsal([later, first, told(4, op="pause"), second], 20)
    assert rehearsal.due(2) == []
    assert rehearsal.due(8) == [first, second]
    assert rehearsal.due(8) == []
    assert rehearsal.due(30) == [later]


def test_many_edits_at_one_frame_are_due_in_parts() -> None:
    """All at once would keep the other characters waiting, and be more than servers accept."""
    edits = [told(0, op="clear_constraints", number=number) for number in range(150)]
    rehearsal = Rehearsal(edits, 20)
    parts = [rehearsal.due(0) for _ in range(4)]
    assert [len(part) for part in parts] == [64, 64, 22, 0]
    assert list(itertools.chain(*parts)) == edits


async def test_edits_after_the_last_frame_are_reported_as_left_out(bridge: Bridge, room: Room) -> None:
    edits = (told(0, op="clear_constraints"), told(9, op="clear_constraints"))
    again = room.character(await room.again(SessionFile({}, 3, edits), {}))
    async with asyncio.timeout(LIMIT_S):
        while not again.session.is_paused:
            await bridge.beat()
    assert len(again.edits.entries) == 1
    assert again.failure == "its last frame came before 1 of its edits, which are not repeated"


def test_ids_are_replaced_by_those_of_the_new_character() -> None:
    """In the recording a refused edit had taken constraint 1; it is not repeated, so that 1 is the next one's."""
    rehearsal = Rehearsal([], 20)
    add = told(3, None, (2,), op="add_constraints")
    rehearsal.told(add, SimpleNamespace(prompt_id=None, constraint_ids=(1,)))  # type: ignore[arg-type]
    rehearsal.told(told(4, 5, op="set_prompt"), SimpleNamespace(prompt_id=2, constraint_ids=()))  # type: ignore[arg-type]
    assert rehearsal.renumbered({"op": "remove_constraints", "constraint_ids": [2, 9]})["constraint_ids"] == [1, 9]
    assert rehearsal.renumbered({"op": "replace_constraint", "constraint_id": 2})["constraint_id"] == 1
    assert rehearsal.renumbered({"op": "remove_prompts", "prompt_ids": [5]})["prompt_ids"] == [2]
    assert rehearsal.renumbered({"op": "set_prompt", "prompt_id": 5})["prompt_id"] == 2


async def test_the_edits_of_a_character_are_repeated_for_another(page: Page, room: Room) -> None:
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


async def test_only_fields_of_an_opening_can_be_changed(page: Page, room: Room) -> None:
    await page.ask(op="add", text="a person stands")
    with pytest.raises(InvalidInput, match="only text"):
        await room.again(session_of(room.character(1)), {"colour": "red"})
    answer = await page.ask(op="again", character=1, changes=[])
    assert "an object" in answer["error"]


@pytest.mark.parametrize(
    "message",
    [
        {"op": "dance"},
        {"op": "set_prompt", "text": "run", "prompt_id": [1]},
        {"op": "remove_prompts", "prompt_ids": [10**20]},
        {"op": "add_constraints", "constraints": [LIMB | {"joints": ["LeftHand"]}]},
        {"op": "add_constraints", "constraints": [LIMB | {"joints": [-1]}]},
    ],
)
async def test_an_edit_that_cannot_be_repeated_is_reported_and_the_rest_continues(
    bridge: Bridge, room: Room, server: FakeServer, message: dict[str, Any]
) -> None:
    await room.add({"text": "a person stands"})
    number = await room.again(SessionFile({}, 50, (told(0, **message),)), {})
    again, other = room.character(number), room.character(1)
    await wait_for_frames(bridge, again)
    await wait_for_frames(bridge, other)
    assert "frame 0 cannot be repeated" in again.failure
    assert not again.shown()["is_rehearsing"]
    assert not other.failure
    await room.remove(number)
    assert [event.session for event in server.stream.received if event.HasField("close")] == [again.session.handle]


async def test_fields_that_an_edit_does_not_take_are_ignored(bridge: Bridge, room: Room) -> None:
    message = {"op": "clear_constraints", "constraints": [{}], "prompt_id": [1]}
    (number,) = [await room.again(SessionFile({}, 50, (told(0, **message),)), {})]
    await wait_for_frames(bridge, room.character(number))
    assert room.character(number).failure == ""
    assert [entry.what for entry in room.character(number).edits.entries] == ["the removal of all constraints"]


async def test_an_unexpected_error_fails_only_its_character(
    bridge: Bridge, room: Room, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: Any) -> Any:
        raise TypeError("what nobody thought of")

    await room.add({"text": "a person stands"})
    monkeypatch.setattr("motiongen_tools.view.character.apply", fail)
    number = await room.again(SessionFile({}, 50, (told(0, op="clear_constraints"), told(2, op="pause"))), {})
    await wait_for_frames(bridge, room.character(number))
    await wait_for_frames(bridge, room.character(1))
    assert "log says why" in room.character(number).failure
    assert [record.exc_info[0] for record in caplog.records if record.exc_info] == [TypeError]


async def test_a_failed_rehearsal_pauses_while_the_room_has_no_viewer(
    room: Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    number = await room.again(SessionFile({}, 50, (told(0, op="dance"),)), {})
    room.tick()
    assert room.character(number).failure
    now_s = room.clock()
    monkeypatch.setattr(room, "clock", lambda: now_s + IDLE_S + 1)
    room.tick()
    assert room.character(number).session.is_paused


async def wait_for_frames(bridge: Bridge, character: Character) -> None:
    """Wait until the character has played a few more frames."""
    playback = character.session.playback
    end = playback.playhead + 3
    async with asyncio.timeout(LIMIT_S):
        while playback.playhead < end:
            await bridge.beat()
