"""A page and the bridge: what the page receives, what it may send, and the answers it gets."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import math
from collections.abc import Iterator

import numpy as np
import pytest

from motiongen.v1 import session_pb2
from motiongen_tools.view.access import Role
from motiongen_tools.view.bridge import Bridge
from motiongen_tools.view.browser import MOST_WAITING, Browser
from motiongen_tools.view.room import KEEP_S, Room
from tests.client.fake_server import FakeServer
from tests.client.synthetic import ROW_WIDTH, synthetic_rows
from tests.tools.view.conftest import Page


@pytest.fixture
def server(request: pytest.FixtureRequest) -> Iterator[FakeServer]:
    """A hundred frames a second, unless a test gives another rate."""
    with FakeServer(frame_rate=getattr(request, "param", 100)) as running:
        yield running


async def test_a_page_receives_the_server_state_catalogue_and_characters(page: Page) -> None:
    await page.until(lambda: page.last("characters"))
    assert page.last("server")["state"] == "connected"
    assert [rig["id"] for rig in page.last("catalog")["rigs"]] == ["stick9"]
    assert page.last("characters")["numbers"] == []


async def test_a_page_receives_all_frames_of_a_character_in_order(page: Page) -> None:
    answer = await page.ask(op="add", count=1, text="a person stands")
    assert answer["numbers"] == [1]
    told = await page.until(lambda: page.last("character"))
    assert (told["model"], told["spans"][0]["text"]) == ("synthetic", "a person stands")
    await page.until(lambda: any(header["heads"] and header["heads"][0][4] >= 80 for header, _ in page.frames))
    end = 0
    for header, numbers in page.frames:
        ((number, place, _, _, buffered_to, first, count),) = header["heads"]
        assert number == 1
        if count:
            assert end <= first <= max(end, place - 1), "none is sent twice, and only past ones are left out"
            end = first + count
            rows = numbers.reshape(count, ROW_WIDTH)
            np.testing.assert_allclose(rows[:, 2], 0.05 * np.arange(first, end), atol=1e-5)
        assert end == buffered_to


async def test_an_accepted_edit_replaces_frames_and_adds_a_seam(page: Page) -> None:
    await page.ask(op="add")
    await page.until(lambda: page.frames)
    shown = len(page.frames)
    answer = await page.ask(op="set_prompt", character=1, text="a person runs")
    assert answer["entry"] == 1
    effective = (await page.until(lambda: _accepted(page)))[0]["effective_frame"]
    await page.until(lambda: any(_holds(header, effective) for header, _ in page.frames[shown:]))
    await page.until(lambda: effective in page.last("character")["seams"])


def _holds(header: dict, frame: int) -> bool:
    """Whether a message has rows of that frame."""
    return bool(header["heads"]) and header["heads"][0][5] <= frame < sum(header["heads"][0][5:7])


def _accepted(page: Page) -> list[dict]:
    told = page.last("character")
    return [edit for edit in told["edits"] if edit["state"] == "accepted"] if told else []


async def test_a_refusal_is_shown_with_its_reason(page: Page, server: FakeServer) -> None:
    await page.ask(op="add")
    server.refuse = lambda event: "NO_TARGET" if event.WhichOneof("event") == "edit_constraints" else ""
    waypoint = {"kind": "waypoint", "frame": 70, "x_m": 0, "z_m": 3}
    await page.ask(op="add_constraints", character=1, constraints=[waypoint])
    refused = await page.until(
        lambda: [e for m in page.messages if m["type"] == "character" for e in m["edits"] if e["state"] == "refused"]
    )
    assert "NO_TARGET" in refused[0]["detail"]
    assert page.last("character")["targets"] == []


async def test_an_edit_can_be_undone(page: Page) -> None:
    await page.ask(op="add", text="a person stands")
    assert "error" in await page.ask(op="undo", character=1)
    await page.ask(op="set_prompt", character=1, text="a person runs")
    await page.until(lambda: _accepted(page))
    await page.ask(op="undo", character=1)
    await page.until(lambda: page.last("character")["spans"][-1]["text"] == "a person stands")


async def test_invalid_requests_are_answered_and_later_ones_still_work(page: Page) -> None:
    for number, said in enumerate(("not json", "9" * 5000, "[" * 100_000)):
        page.say(said)
        await page.until(lambda least=number: sum("JSON" in m.get("error", "") for m in page.messages) > least)
    assert "add one" in (await page.ask(op="set_prompt", character=1, text="run"))["error"]
    await page.ask(op="add")
    mistakes = (
        {"op": "dance"},
        {"op": "set_prompt", "text": " "},
        {"op": "time_scale", "scale": 9},
        {"op": "add", "count": 900},
    )
    for wrong in mistakes:
        assert "allowed" in (await page.ask(character=1, **wrong))["error"], wrong
    assert "error" not in await page.ask(op="ping", at=3)


async def test_a_binary_message_is_answered_with_an_error(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    hear = page.receive_text

    async def as_starlette_does() -> str:
        said = {"bytes": b""} if (text := await hear()) == "bytes" else {"text": text}
        return said["text"]  # type: ignore[return-value]

    monkeypatch.setattr(page, "receive_text", as_starlette_does)
    await page.ask(op="ping")  # until now, the bridge waited in the original
    page.say("bytes")
    await page.until(lambda: any("JSON" in m.get("error", "") for m in page.messages))
    assert "error" not in await page.ask(op="ping")


async def test_spectators_may_watch_but_not_steer(bridge: Bridge, room: Room, page: Page) -> None:
    await page.ask(op="add")
    watcher = Page()
    serving = asyncio.create_task(Browser(watcher, bridge, room, Role.WATCH).serve())
    await watcher.until(lambda: watcher.frames and watcher.last("character"))
    assert watcher.last("server")["role"] == "watch"
    for forbidden in ({"op": "add"}, {"op": "remove", "character": 1}, {"op": "pause", "character": 1}):
        assert "spectators" in (await watcher.ask(**forbidden))["error"]
    assert "error" not in await watcher.ask(op="history", character=1, first_frame=0, end_frame=10)
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)


class Stuck(Page):
    """A page that keeps sending requests, and reads nothing."""

    def __init__(self, request: dict) -> None:
        super().__init__()
        self.num_said = 0
        self._request = json.dumps(request)

    async def receive_text(self) -> str:
        if self.num_said == 1000:
            return await super().receive_text()  # nothing more
        self.num_said += 1
        return self._request

    async def send_text(self, data: str) -> None:
        await asyncio.Event().wait()


@pytest.mark.parametrize(
    "request_", [{"op": "history", "character": 1, "first_frame": 0, "end_frame": 99}, {"op": "ping"}, {"op": "add"}]
)
async def test_requests_of_a_page_that_reads_nothing_are_soon_left_unread(
    bridge: Bridge, room: Room, page: Page, request_: dict
) -> None:
    await page.ask(op="add")
    stuck = Stuck(request_)
    browser = Browser(stuck, bridge, room, Role.WATCH)
    serving = asyncio.create_task(browser.serve())
    for _ in range(20):
        await bridge.beat()
    assert browser.num_waiting <= 2 * MOST_WAITING, "a request for history has an answer and its frames"
    assert stuck.num_said <= 2 * MOST_WAITING, "some had been taken to be answered"
    assert "error" not in await page.ask(op="ping"), "other pages are answered"
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)


async def test_a_page_with_many_pending_requests_gets_all_answers(page: Page) -> None:
    await page.ask(op="add")
    for number in range(5 * MOST_WAITING):
        page.say(json.dumps({"op": "history", "character": 1, "first_frame": 0, "end_frame": 1, "request": -number}))
    await page.until(lambda: [m for m in page.messages if m.get("request") == 1 - 5 * MOST_WAITING])
    await page.until(lambda: sum(header["type"] == "history" for header, _ in page.frames) == 5 * MOST_WAITING)


async def test_a_number_that_is_not_finite_is_sent_to_a_page_as_null(page: Page, server: FakeServer) -> None:
    await page.ask(op="add")
    await page.ask(op="add_constraints", character=1, constraints=[{"kind": "heading", "frame": 70, "heading_rad": 1}])
    await page.until(lambda: page.last("character")["targets"])
    reached = session_pb2.ConstraintReached(constraint_id=1, met=False, frame=70, rotation_error_rad=math.nan)
    server.stream.push(1, constraint_reached=reached)
    await page.until(lambda: page.last("character")["targets"][0]["state"] == "missed")
    assert page.last("character")["targets"][0]["rotation_error_rad"] is None


async def test_a_frame_that_cannot_be_shown_is_reported(
    page: Page, room: Room, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(plan: int, first: int, count: int) -> np.ndarray:
        rows = synthetic_rows(plan, first, count)
        rows[first + np.arange(count) == 21, 2] = math.nan
        return rows

    monkeypatch.setattr("tests.client.fake_server.synthetic_rows", broken)
    await page.ask(op="add")
    await page.until(lambda: (page.last("character") or {}).get("failure"))
    assert page.last("character")["failure"].startswith("frame 21 has a number that is not finite")
    assert not room.character(1).has_ended


async def test_a_character_is_sent_with_its_rig_if_the_catalogue_lacks_it(
    bridge: Bridge, room: Room, page: Page
) -> None:
    await page.ask(op="add")
    await page.until(lambda: page.last("character"))
    assert "described" not in page.last("character")
    client = bridge.line.client
    client.catalog = dataclasses.replace(client.catalog, etag="2", rigs=())
    late = Page()
    serving = asyncio.create_task(Browser(late, bridge, room, Role.CONTROL).serve())
    told = await late.until(lambda: late.last("character"))
    assert (told["described"]["id"], told["described"]["row_width"]) == (told["rig"], ROW_WIDTH)
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)


@pytest.mark.parametrize("server", [10, 100], indirect=True)
async def test_history_can_be_requested_for_as_many_seconds_at_any_rate(
    page: Page, room: Room, server: FakeServer
) -> None:
    await page.ask(op="add")
    kept = room.character(1).session.rig.frames_in(KEEP_S)
    assert kept == KEEP_S * server.frame_rate
    assert "error" not in await page.ask(op="history", character=1, first_frame=0, end_frame=kept)
    assert "allowed" in (await page.ask(op="history", character=1, first_frame=0, end_frame=2 * kept))["error"]


async def test_a_changed_catalogue_is_sent_to_the_page_once(bridge: Bridge, page: Page) -> None:
    await page.until(lambda: page.last("characters"))
    client = bridge.line.client
    (model,) = client.catalog.models
    client.catalog = dataclasses.replace(
        client.catalog, etag="2", models=(dataclasses.replace(model, model_id="other"),)
    )
    await page.until(lambda: [model["id"] for model in page.last("catalog")["models"]] == ["other"])
    for _ in range(3):
        await bridge.beat()
    assert sum(message["type"] == "catalog" for message in page.messages) == 2, "once each"


async def test_played_frames_can_be_requested_again(page: Page) -> None:
    await page.ask(op="add")
    await page.until(lambda: any(h["type"] == "frames" and h["heads"] and h["heads"][0][1] > 3 for h, _ in page.frames))
    await page.ask(op="history", character=1, first_frame=1, end_frame=3)
    header, rows = await page.until(lambda: next(((h, r) for h, r in page.frames if h["type"] == "history"), None))
    assert (header["first_frame"], header["num_frames"]) == (1, 2)
    np.testing.assert_allclose(rows.reshape(2, -1)[:, 2], [0.05, 0.1], atol=1e-6)


async def test_a_removed_character_is_gone_from_the_room_and_the_page(page: Page, room: Room) -> None:
    await page.ask(op="add", count=3)
    await page.ask(op="remove", character=2)
    await page.until(lambda: page.last("characters")["numbers"] == [1, 3])
    assert sorted(room.characters) == [1, 3]


async def test_frames_are_sent_only_after_their_character_is_described(bridge: Bridge, room: Room) -> None:
    browser = Browser(Page(), bridge, room, Role.CONTROL)
    assert [message["type"] for message in browser.news()][:2] == ["server", "catalog"]
    await room.add({})  # while the earlier news is on its way
    assert browser.heads() == []
    assert "character" in [message["type"] for message in browser.news()]
    assert [head.character for head in browser.heads()] == [1]


async def test_a_scheduled_prompt_has_no_latency(page: Page) -> None:
    await page.ask(op="add")
    await page.ask(op="set_prompt", character=1, text="a person waves", frame=60, end_frame=80)
    await page.ask(op="set_prompt", character=1, text="a person runs")
    await page.until(lambda: [e for e in _accepted(page) if e["number"] == 2 and e["latency_ms"] is not None])
    assert [e["latency_ms"] for e in _accepted(page) if e["number"] == 1] == [None]
