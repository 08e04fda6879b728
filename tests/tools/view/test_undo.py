"""Undo: edits step by step, cuts by continuing from before them, and options by their earlier values."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from motiongen_client.errors import InvalidInput
from motiongen_tools.view.bridge import Bridge
from motiongen_tools.view.character import Character
from motiongen_tools.view.edit_log import Entry
from motiongen_tools.view.fields import Message
from motiongen_tools.view.room import Room
from tests.client.fake_server import FakeServer
from tests.waiting import LIMIT_S

OPTIONS = {
    "priority": "near",
    "lookahead_frames": 80,
    "steps": 4,
    "history_frames": 4,
    "text_guidance": 2.5,
    "constraint_guidance": 2.0,
}


class Steered:
    """A character of a room whose bridge beats."""

    def __init__(self, bridge: Bridge, character: Character) -> None:
        self._bridge = bridge
        self.character = character

    async def tell(self, message: Message) -> Entry:
        """Send an edit, and wait until its answer is noted."""
        entry = self.character.tell(message)
        await self.until(lambda: entry.state != "sent")
        assert entry.state == "accepted", entry.detail
        return entry

    async def undo(self) -> Message:
        """Undo the last edit; returns the message that was sent for it."""
        return (await self.tell({"op": "undo"})).message

    async def until(self, holds: Callable[[], bool]) -> None:
        async with asyncio.timeout(LIMIT_S):
            while not holds():
                await self._bridge.beat()


@pytest.fixture
async def steered(bridge: Bridge, room: Room) -> Steered:
    (number,) = await room.add({"count": 1, "constraint_guidance": 2.0})
    return Steered(bridge, room.characters[number])


@pytest.mark.parametrize("name", OPTIONS)
async def test_undoing_an_option_restores_its_first_value(steered: Steered, name: str) -> None:
    await steered.tell({"op": "set_options", name: "hero" if name == "priority" else 8})
    assert (await steered.undo())[name] == OPTIONS[name]


async def test_options_are_undone_step_by_step(steered: Steered) -> None:
    await steered.tell({"op": "set_options", "steps": 6, "priority": "hero"})
    await steered.tell({"op": "set_options", "steps": 8})
    assert await steered.undo() == {"op": "set_options", "steps": 6}
    assert await steered.undo() == {"op": "set_options", "steps": 4, "priority": "near"}
    with pytest.raises(InvalidInput, match="undo"):
        steered.character.tell({"op": "undo"})


async def test_a_guidance_weight_that_is_not_given_is_kept(steered: Steered, server: FakeServer) -> None:
    await steered.tell({"op": "set_options", "text_guidance": 0.5})
    await steered.tell({"op": "set_options", "constraint_guidance": 3.0})
    sent = [event.set_options.guidance for event in server.stream.received if event.HasField("set_options")]
    assert [(each.text, each.constraint) for each in sent] == [(0.5, 2.0), (0.5, 3.0)]


@pytest.mark.parametrize("cut", [{"op": "teleport", "x_m": 5.0, "z_m": 5.0}, {"op": "cut_to", "frame": 16}])
async def test_undoing_a_cut_continues_from_before_it(steered: Steered, cut: Message) -> None:
    await steered.until(lambda: steered.character.session.playback.playhead > 40)
    done = await steered.tell(cut)
    assert await steered.undo() == {"op": "cut_to", "frame": done.effective_frame}
    with pytest.raises(InvalidInput, match="undo"):
        steered.character.tell({"op": "undo"})


def prompt(text: str) -> Message:
    return {"op": "set_prompt", "text": text}


async def test_edits_sent_before_an_answer_are_undone_step_by_step(steered: Steered) -> None:
    """The second is sent before the first has its answer; undoing it must restore the first."""
    steered.character.tell(prompt("a person walks"))
    await steered.tell(prompt("a person runs"))
    assert await steered.undo() == prompt("a person walks")
    assert (await steered.undo())["op"] == "remove_prompts"


async def test_unanswered_options_are_kept_by_the_next_ones(steered: Steered, server: FakeServer) -> None:
    steered.character.tell({"op": "set_options", "text_guidance": 0.5})
    await steered.tell({"op": "set_options", "constraint_guidance": 3.0})
    sent = [event.set_options.guidance for event in server.stream.received if event.HasField("set_options")]
    assert [(each.text, each.constraint) for each in sent] == [(0.5, 2.0), (0.5, 3.0)]
    assert await steered.undo() == {"op": "set_options", "text_guidance": 0.5, "constraint_guidance": 2.0}
    assert await steered.undo() == {"op": "set_options", "text_guidance": 2.5, "constraint_guidance": 2.0}


async def test_refused_options_are_not_kept(steered: Steered, server: FakeServer) -> None:
    server.refuse = lambda event: "OUT_OF_RANGE" if event.set_options.guidance.text == 99 else ""
    refused = steered.character.tell({"op": "set_options", "text_guidance": 99.0})
    await steered.until(lambda: refused.state == "refused")
    done = await steered.tell({"op": "set_options", "constraint_guidance": 3.0})
    assert done.message["text_guidance"] == 2.5


async def test_undo_does_not_skip_an_unanswered_edit(steered: Steered) -> None:
    """Otherwise the one before it would be undone, which nobody meant."""
    await steered.tell(prompt("a person walks"))
    entry = steered.character.tell(prompt("a person runs"))
    with pytest.raises(InvalidInput, match="once the server has answered it"):
        steered.character.tell({"op": "undo"})
    await steered.until(lambda: entry.state == "accepted")
    assert await steered.undo() == prompt("a person walks")


async def test_undo_skips_refused_edits_and_pauses(steered: Steered, server: FakeServer) -> None:
    await steered.tell(prompt("a person walks"))
    server.refuse = lambda event: "NO_TARGET" if event.HasField("edit_constraints") else ""
    refused = steered.character.tell({"op": "clear_constraints"})
    steered.character.tell({"op": "pause"})
    await steered.until(lambda: refused.state == "refused")
    assert (await steered.undo())["op"] == "remove_prompts"


async def test_undo_skips_empty_options(steered: Steered) -> None:
    await steered.tell(prompt("a person walks"))
    await steered.tell({"op": "set_options"})
    assert (await steered.undo())["op"] == "remove_prompts"
