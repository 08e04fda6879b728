"""Rooms: where characters stand, how many there may be, and what happens while there is no viewer."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from motiongen.v1 import session_pb2
from motiongen_client import EventRefused, MotionClient, Session, StartPose
from motiongen_client.errors import InvalidInput, ServerUnavailable, UnknownName
from motiongen_tools.view.bridge import MOST_ROOMS, Bridge
from motiongen_tools.view.line import Line
from motiongen_tools.view.room import IDLE_S, SPACING_M, Room, place_of, session_options
from motiongen_tools.view.session_file import SessionFile
from tests.client.fake_server import FakeServer
from tests.waiting import LIMIT_S


class Looker:
    """A viewer that only watches."""

    def rewind(self, character: int, frame: int) -> None: ...

    def forget(self, character: int) -> None: ...


def test_start_places_of_characters_are_distinct_and_near_the_origin() -> None:
    places = [place_of(number) for number in range(1, 201)]
    assert places[0].x_m == places[0].z_m == 0
    assert len({(place.x_m, place.z_m) for place in places}) == 200
    assert max(max(abs(place.x_m), abs(place.z_m)) for place in places) <= 8 * SPACING_M


async def test_a_place_that_became_free_is_used_again(room: Room, server: FakeServer) -> None:
    """Otherwise characters would start ever further away as others are added and removed."""
    await room.add({"count": 3})
    await room.remove(2)
    server.refuse = lambda event: "OVERLOADED" if event.WhichOneof("event") == "open" else ""
    with pytest.raises(EventRefused):
        await room.add({})
    server.refuse = lambda event: ""
    await room.add({"count": 2})
    starts = [character.options.start for character in room.characters.values()]
    assert starts == [place_of(place) for place in (1, 3, 2, 4)]


async def test_the_number_of_characters_of_a_room_is_limited(room: Room) -> None:
    assert await room.add({"count": 2}) == [1, 2]
    with pytest.raises(InvalidInput, match="at most 198 more"):
        await room.add({"count": 199})


async def test_a_refused_open_raises_and_adds_no_character(room: Room, server: FakeServer) -> None:
    server.refuse = lambda event: "OVERLOADED" if event.WhichOneof("event") == "open" else ""
    with pytest.raises(EventRefused, match="OVERLOADED"):
        await room.add({})
    assert not room.characters


async def test_characters_pause_while_the_room_has_no_viewer(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    room = bridge.room("quiet")
    await room.add({"count": 2})
    room.characters[2].session.pause()
    now_s = room.clock()
    monkeypatch.setattr(room, "clock", lambda: now_s + IDLE_S + 1)
    room.tick()
    assert all(character.session.is_paused for character in room.characters.values())

    room.viewers.add(Looker())
    room.tick()
    assert not room.characters[1].session.is_paused
    assert room.characters[2].session.is_paused, "it was paused by a user, not for want of viewers"


async def test_pausing_and_resuming_are_reported_to_pages(room: Room, monkeypatch: pytest.MonkeyPatch) -> None:
    await room.add({})
    character, now_s = room.characters[1], room.clock()
    monkeypatch.setattr(room, "clock", lambda: now_s + IDLE_S + 1)
    for is_paused in (True, False):
        before = character.revision
        room.tick()
        assert character.shown()["is_paused"] is is_paused
        assert character.revision > before
        room.viewers.add(Looker())


async def test_an_empty_room_is_kept_while_a_character_is_being_opened(
    bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page that opened a session file may be gone meanwhile; its character must be in a room that is served."""
    client = bridge.line.client
    really_open = client.open

    async def open_slowly(*given: Any, **named: Any) -> Session:
        bridge.room("another")  # for which empty rooms are dropped
        return await really_open(*given, **named)

    monkeypatch.setattr(client, "open", open_slowly)
    room = bridge.room("empty")
    assert await room.again(SessionFile({}, 50, ()), {}) == 1
    assert bridge.rooms["empty"] is room


async def test_a_character_that_ended_meanwhile_does_not_keep_others_paused(
    bridge: Bridge, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = bridge.room("quiet")
    await room.add({"count": 2})
    now_s = room.clock()
    monkeypatch.setattr(room, "clock", lambda: now_s + IDLE_S + 1)
    room.tick()
    ended, other = (character.session for character in room.characters.values())
    idle = session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_IDLE)
    server.stream.push(ended.handle, closed=idle)
    async with asyncio.timeout(LIMIT_S):
        while ended.end is None:
            await bridge.beat()
    room.viewers.add(Looker())
    room.tick()
    assert not other.is_paused
    async with asyncio.timeout(LIMIT_S):
        while not room.characters[1].failure:
            await bridge.beat()
    assert "idle" in room.characters[1].failure
    assert not room.characters[2].failure


async def test_a_failing_character_ends_neither_the_others_nor_the_bridge(
    bridge: Bridge, room: Room, server: FakeServer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> None:
        raise ZeroDivisionError("at every tick")

    await room.add({"count": 2})
    failing, other = room.characters.values()
    monkeypatch.setattr(failing.session, "poll", fail)
    before = failing.revision
    async with asyncio.timeout(LIMIT_S):
        while other.session.playback.playhead < 3:
            await bridge.beat()
    assert "log says why" in failing.shown()["failure"]
    assert failing.revision > before, "pages must be told"
    assert [record.exc_info[0] for record in caplog.records if record.exc_info] == [ZeroDivisionError]
    assert not other.failure
    await room.remove(failing.number)
    assert [event.session for event in server.stream.received if event.HasField("close")] == [failing.session.handle]


async def test_a_character_that_cannot_be_shown_is_not_left_on_the_server(room: Room, server: FakeServer) -> None:
    with pytest.raises(InvalidInput, match="name"):
        await room.add({"name": 5})
    with pytest.raises(UnknownName):
        await room.add({"model": "one that the catalogue has not"})  # another server's, say
    assert not any(stream.characters for stream in server.streams)


async def test_names_of_rooms_are_checked_and_their_number_is_limited(bridge: Bridge) -> None:
    assert bridge.room("main") is bridge.room("main")
    with pytest.raises(InvalidInput, match="letters"):
        bridge.room("../etc")
    for number in range(MOST_ROOMS + 5):
        bridge.room(f"empty{number}")  # earlier empty rooms are dropped
    for number in range(MOST_ROOMS):
        await bridge.room(f"used{number}").add({})
    with pytest.raises(InvalidInput, match="one of the 16"):
        bridge.room("one-more")


def test_options_of_a_session_are_checked() -> None:
    options = session_options({"seed": "18446744073709551615", "priority": "hero", "steps": 6}, StartPose())
    assert (options.seed, options.priority.value, options.denoise_steps) == (2**64 - 1, "hero", 6)
    placed = session_options({"start": {"x_m": 1, "z_m": 2}}, StartPose()).start
    assert (placed.x_m, placed.z_m, placed.heading_rad) == (1, 2, 0)
    for wrong in ({"seed": -1}, {"seed": "9" * 5000}, {"priority": "king"}, {"steps": 1.5}, {"start": [0, 0]}):
        with pytest.raises(InvalidInput):
            session_options(wrong, StartPose())


async def test_a_bridge_without_a_server_keeps_connecting() -> None:
    line = Line(lambda: MotionClient("localhost:1", connect_timeout_s=0.05))
    bridge = Bridge(line)
    running = asyncio.create_task(bridge.run())
    async with asyncio.timeout(LIMIT_S):
        while "localhost:1" not in line.shown(0)["detail"]:
            await bridge.beat()
    with pytest.raises(ServerUnavailable) as waiting:
        await bridge.room("main").add({})
    assert str(waiting.value) == line.shown(0)["detail"], "the reason is not repeated"
    assert line.shown(0)["state"] == "connecting"
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
