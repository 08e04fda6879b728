"""The bridge's web server: which requests it serves, the files of the page, takes and motion files."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import quote

import httpx
import numpy as np
import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from motiongen_client import Motion, MotionClient
from motiongen_tools.npz import read_npz, write_npz
from motiongen_tools.view.access import Access
from motiongen_tools.view.bridge import Bridge
from motiongen_tools.view.line import Line
from motiongen_tools.view.motion_files import MAX_BYTES
from motiongen_tools.view.page_files import PAGE, ThreeMissing, three_folder
from motiongen_tools.view.room import Room
from motiongen_tools.view.session_file import FORMAT
from motiongen_tools.view.web import DENIED, MOST_MADE_AT_ONCE, UNKNOWN_ROOM, _first_free, web_app
from tests.tools.view.conftest import LIMIT_S, beats_until

LOCAL = "http://localhost:8321"
HOST = {"host": "localhost:8321"}
WITH_TOKENS = Access("steer", "look")
WAYPOINT = {"kind": "waypoint", "frame": 0, "x_m": 1.0, "z_m": 2.0}


@pytest.fixture
def three(tmp_path: Path) -> Path:
    """A folder that looks like the npm package."""
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "three.module.js").write_text("export {};")
    return tmp_path


@pytest.fixture
def idle() -> Bridge:
    """A bridge without a server, which does nothing."""
    return Bridge(Line(lambda: MotionClient("localhost:1")))


@pytest.fixture
def open_site(idle: Bridge, three: Path) -> Iterator[TestClient]:
    with TestClient(web_app(idle, Access(), three), base_url=LOCAL) as site:
        yield site


@pytest.fixture
def guarded_site(idle: Bridge, three: Path) -> Iterator[TestClient]:
    with TestClient(web_app(idle, WITH_TOKENS, three), base_url="http://example.org") as site:
        yield site


def test_the_page_and_three_js_are_served(open_site: TestClient) -> None:
    page = open_site.get("/")
    assert page.status_code == 200
    assert "importmap" in page.text
    assert "script-src 'self' 'sha256-" in page.headers["content-security-policy"]
    assert open_site.get("/three/build/three.module.js").status_code == 200
    assert open_site.get("/main.js").headers["content-type"].startswith("text/javascript")


def test_every_module_that_a_module_imports_exists() -> None:
    for module in [path for path in PAGE.rglob("*.js") if "node_modules" not in path.parts]:
        for line in module.read_text(encoding="utf-8").splitlines():
            if ' from "./' in line or ' from "../' in line:
                named = module.parent / line.split(' from "')[1].split('"')[0]
                assert named.resolve().is_file(), f"{module.name}: {line}"


def test_posts_from_other_sites_are_refused(open_site: TestClient) -> None:
    for address in ("/session/main", "/motion?name=walk.bvh", "/constraints/main/1"):
        posted = open_site.post(address, content=b"{}", headers={"origin": "http://evil.example"})
        assert (posted.status_code, posted.text) == (403, "the page belongs to another site")
        assert open_site.post(address, content=b"{}", headers={"origin": LOCAL}).status_code == 400


def test_requests_by_pictures_and_links_of_other_sites_are_refused(open_site: TestClient) -> None:
    """Browsers send no origin with these, but they say that another site asks."""
    for site, status in (("cross-site", 403), ("same-site", 403), ("same-origin", 400), ("none", 400)):
        assert open_site.get("/take/main/1/a.glb", headers={"sec-fetch-site": site}).status_code == status
    assert open_site.get("/main.js").headers["cross-origin-resource-policy"] == "same-origin"


def test_a_malformed_host_or_origin_is_refused(open_site: TestClient) -> None:
    assert open_site.get("/", headers={"host": "["}).status_code == 421
    assert open_site.post("/session/main", content=b"{}", headers={"origin": "http://["}).status_code == 403
    with open_site.websocket_connect("/ws", headers=HOST | {"origin": "http://["}) as socket:
        assert socket.receive()["code"] == DENIED


def test_other_host_names_are_refused(open_site: TestClient) -> None:
    assert open_site.get("/", headers={"host": "evil.example"}).status_code == 421
    with pytest.raises(WebSocketDisconnect), open_site.websocket_connect("/ws", headers={"host": "evil.example"}):
        pass


def test_sockets_of_pages_of_other_sites_are_refused(open_site: TestClient) -> None:
    with open_site.websocket_connect("/ws", headers=HOST | {"origin": "http://evil.example"}) as socket:
        assert socket.receive()["code"] == DENIED


def test_requests_without_a_valid_token_are_refused(guarded_site: TestClient) -> None:
    for query in ("", "?token=guess"):
        with guarded_site.websocket_connect(f"/ws{query}") as socket:
            assert socket.receive()["code"] == DENIED
    assert guarded_site.get("/take/main/1/a.npz").status_code == 401
    assert guarded_site.post("/motion?name=a.npz", headers={"authorization": "Bearer look"}).status_code == 401


def test_a_room_with_an_invalid_name_is_refused(open_site: TestClient) -> None:
    with open_site.websocket_connect("/ws?room=a/b", headers=HOST) as socket:
        assert socket.receive()["code"] == UNKNOWN_ROOM


def test_the_reason_of_a_close_frame_is_cut_to_its_limit(open_site: TestClient) -> None:
    with open_site.websocket_connect(f"/ws?room={'%E5%AE%A4' * 60}%20", headers=HOST) as socket:
        closed = socket.receive()
    assert closed["code"] == UNKNOWN_ROOM
    assert 100 < len(closed["reason"].encode()) <= 123


def test_a_missing_three_js_is_reported_with_advice(tmp_path: Path) -> None:
    with pytest.raises(ThreeMissing, match="make viewer"):
        three_folder(tmp_path)


def test_the_lock_file_pins_the_dependencies_and_names_no_registry() -> None:
    asked = json.loads((PAGE / "package.json").read_text())["dependencies"]
    lock = json.loads((PAGE / "package-lock.json").read_text())["packages"]
    assert {name: lock[f"node_modules/{name}"]["version"] for name in asked} == asked
    assert all("resolved" not in package for package in lock.values())
    assert all("integrity" in package for path, package in lock.items() if path)


async def site_of(bridge: Bridge, three: Path) -> httpx.AsyncClient:
    """A client of the web server, in the event loop of the bridge."""
    transport = httpx.ASGITransport(web_app(bridge, Access(), three))
    return httpx.AsyncClient(transport=transport, base_url=LOCAL, timeout=LIMIT_S)


async def test_takes_can_be_downloaded(bridge: Bridge, room: Room, three: Path, tmp_path: Path) -> None:
    (number,) = await room.add({"text": "a person stands"})
    playback = room.character(number).session.playback
    await beats_until(bridge, lambda: playback.playhead >= 5)
    async with await site_of(bridge, three) as site:
        answer = await site.get(f"/take/main/{number}/walk.npz?first=1&end=4")
        (tmp_path / "walk.npz").write_bytes(answer.content)
        motion = read_npz(tmp_path / "walk.npz")
        assert (motion.first_frame, len(motion)) == (1, 3)
        assert (await site.get(f"/take/main/{number}/walk.bvh")).text.startswith("HIERARCHY")
        for name in ("日本.npz", 'a".npz'):
            named = await site.get(f"/take/main/{number}/{quote(name)}")
            assert named.headers["content-disposition"] == f"attachment; filename*=UTF-8''{quote(name)}"
        assert (await site.get(f"/take/main/{number}/walk.bvh?first={'1' * 5000}")).status_code == 200
        session = (await site.get(f"/take/main/{number}/walk.session.json")).json()
        assert session["opening"]["text"] == "a person stands"
        for wrong in (f"/take/main/{number}/walk.exe", "/take/main/9/walk.npz", f"/take/main/{number}/a.npz?first=999"):
            refused = await site.get(wrong)
            assert refused.status_code == 400
            assert "allowed" in refused.json()["error"]


async def test_a_session_file_warns_of_edits_that_are_no_longer_kept(
    bridge: Bridge, room: Room, three: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motiongen_tools.view.edit_log.MOST_KEPT", 2)
    (number,) = await room.add({"text": "a person stands"})
    async with await site_of(bridge, three) as site:
        for text, lost in (("walk", ""), ("run", ""), ("sit", "the first 1 edits"), ("bow", "the first 2 edits")):
            room.character(number).tell({"op": "set_prompt", "text": text})
            answer = await site.get(f"/take/main/{number}/walk.session.json")
            assert answer.headers["x-warnings"].startswith(lost)
            assert bool(answer.headers["x-warnings"]) is bool(lost)


async def test_an_invalid_session_file_is_refused_when_it_is_opened(bridge: Bridge, three: Path) -> None:
    wrong = {"op": "remove_prompts", "prompt_ids": ["1"], "at_frame": 4}
    whole = {"format": FORMAT, "opening": {}, "num_frames": 9, "edits": [wrong]}
    async with await site_of(bridge, three) as site:
        refused = await site.post("/session/main?name=a.json", content=json.dumps(whole))
        assert (refused.status_code, list(bridge.room("main").characters)) == (400, [])
        assert "a.json, edits[0], prompt_ids: ['1'] was given" in refused.json()["error"]
        taken = await site.post("/session/main?name=a.json", content=json.dumps({**whole, "edits": []}))
        assert taken.json() == {"numbers": [1]}


async def test_motion_files_can_be_opened(bridge: Bridge, three: Path, tmp_path: Path, stick_motion: Motion) -> None:
    write_npz(tmp_path / "walk.npz", stick_motion)
    async with await site_of(bridge, three) as site:
        opened = await site.post("/motion?name=walk.npz", content=(tmp_path / "walk.npz").read_bytes())
        rows = np.frombuffer(opened.content[-stick_motion.rows.nbytes :], "<f4")
        np.testing.assert_array_equal(rows.reshape(stick_motion.rows.shape), stick_motion.rows)
        for name, content in (
            ("walk.npz", b"junk"),
            ("walk", b"junk"),
            ("walk.bvh", b""),
            ("a.%00npz", b"junk"),
            ("a." + 300 * "b", b"junk"),
        ):
            refused = await site.post(f"/motion?name={name}", content=content)
            assert refused.status_code == 400, name
        big = await site.post("/motion?name=a.npz", content=b"", headers={"content-length": str(MAX_BYTES + 1)})
        assert big.status_code == 400


async def test_an_unexpected_error_is_answered_and_logged(
    bridge: Bridge, room: Room, three: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    (number,) = await room.add({})
    monkeypatch.setattr("motiongen_tools.view.web.write_take", fail)
    async with await site_of(bridge, three) as site:
        answer = await site.get(f"/take/main/{number}/walk.npz")
    assert (answer.status_code, "log says why" in answer.json()["error"]) == (500, True)
    assert [record.exc_info[0] for record in caplog.records if record.exc_info] == [ZeroDivisionError]


async def test_constraints_are_read_and_written_outside_the_event_loop(
    bridge: Bridge, room: Room, three: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There may be thousands, and fitting a limb takes long: all characters would stop meanwhile."""
    loop, main = asyncio.get_running_loop(), threading.current_thread()

    def after_a_beat(found: object) -> Callable[..., object]:
        def wait(*_: object) -> object:
            assert threading.current_thread() is not main, "the bridge is blocked"
            asyncio.run_coroutine_threadsafe(bridge.beat(), loop).result(LIMIT_S)
            return found

        return wait

    (number,) = await room.add({})
    playback = room.character(number).session.playback
    await beats_until(bridge, lambda: playback.started)
    monkeypatch.setattr("motiongen_tools.view.web.read_list", after_a_beat([WAYPOINT]))
    monkeypatch.setattr("motiongen_tools.view.recording.write_constraint_list", after_a_beat(("[]", [])))
    async with await site_of(bridge, three) as site:
        before = playback.playhead
        asked = await site.post(f"/constraints/main/{number}", content=b"[]")
        assert asked.json()["count"] == 1
        assert room.character(number).edits.entries[-1].message["constraints"][0]["frame"] > before
        assert (await site.get(f"/take/main/{number}/a.constraints.json")).text == "[]"


async def test_errors_of_a_file_use_the_name_that_the_user_knows(bridge: Bridge, room: Room, three: Path) -> None:
    (number,) = await room.add({})
    await beats_until(bridge, lambda: room.character(number).session.playback.started)
    async with await site_of(bridge, three) as site:
        refused = await site.post("/motion?name=a walk.glb", content=b"glTF")
        assert refused.json()["error"].startswith("a walk.glb: gltf is only written")
        listed = await site.post(f"/constraints/main/{number}?name=list.json", content=b"{")
        assert listed.json()["error"].startswith("constraint file: 'list.json' was given")
        assert "failed: the motion: " in (await site.get(f"/take/main/{number}/a.csv")).text


async def test_the_number_of_files_made_at_once_is_limited(
    bridge: Bridge, room: Room, three: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any spectator may request many of them, and each starts a process."""
    under_way: list[int] = []
    most = 0

    async def make(*_: object) -> tuple[bytes, str, list[str]]:
        nonlocal most
        under_way.append(1)
        most = max(most, len(under_way))
        await bridge.beat()
        under_way.pop()
        return b"", "text/plain", []

    (number,) = await room.add({})
    monkeypatch.setattr("motiongen_tools.view.web.write_take", make)
    async with await site_of(bridge, three) as site:
        answers = await asyncio.gather(*(site.get(f"/take/main/{number}/walk.glb") for _ in range(8)))
    assert {answer.status_code for answer in answers} == {200}
    assert most == MOST_MADE_AT_ONCE


def test_the_first_free_frame_is_later_at_a_high_frame_rate() -> None:
    def first_free(rate_hz: int) -> int:
        playback = SimpleNamespace(committed_to=100, playhead=90)
        rig = SimpleNamespace(frames_in=lambda seconds: round(seconds * rate_hz))
        return _first_free(SimpleNamespace(session=SimpleNamespace(playback=playback, rig=rig)))  # type: ignore[arg-type]

    assert [first_free(rate_hz) for rate_hz in (10, 20, 60)] == [112, 112, 136]
