"""Session files: written, read, refused, and replayed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from motiongen.v1 import session_pb2
from motiongen_client import MotionClient
from motiongen_client.errors import InvalidInput
from motiongen_tools.cli_replay import play
from motiongen_tools.view.edit_log import MOST_KEPT
from motiongen_tools.view.room import Room
from motiongen_tools.view.session_file import (
    FORMAT,
    SessionFile,
    ToldAt,
    parse_session,
    read_session,
    session_of,
    write_session,
)
from tests.client.fake_server import FakeServer
from tests.tools.view.conftest import Page

WAYPOINT = {"kind": "waypoint", "frame": 90, "x_m": 1.0, "z_m": 2.0}
FIRST = {"at_frame": 0, "op": "clear_constraints"}
LIMB = {"kind": "joint_targets", "frame": 90, "positions_m": [[0, 1, 0]]}
SESSION = SessionFile(
    {"text": "a person stands", "seed": "7"},
    60,
    (
        ToldAt(3, 50, {"op": "set_prompt", "text": "a person runs"}),
        ToldAt(9, 50, {"op": "add_constraints", "constraints": [WAYPOINT]}),
        ToldAt(11, None, {"op": "pause"}),
    ),
)


def test_a_session_file_round_trips(tmp_path: Path) -> None:
    (tmp_path / "a.session.json").write_text(write_session(SESSION))
    assert read_session(tmp_path / "a.session.json") == SESSION
    (tmp_path / "empty.json").write_text(write_session(SessionFile({}, 1, ())))
    assert read_session(tmp_path / "empty.json").edits == ()


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("{", "file"),
        ("[]", "file"),
        ('{"format": "other"}', "file"),
        (json.dumps({"format": FORMAT, "edits": {}}), "a.json, edits"),
        (json.dumps({"format": FORMAT, "edits": [], "opening": 3, "num_frames": 3}), "a.json, opening"),
        (json.dumps({"format": FORMAT, "edits": [], "opening": {}, "num_frames": 0}), "a.json, num_frames"),
        (
            json.dumps({"format": FORMAT, "edits": [{"op": "undo"}], "opening": {}, "num_frames": 3}),
            "a.json, edits[0], at_frame",
        ),
        (f'{{"format": "{FORMAT}", "edits": [], "opening": {{}}, "num_frames": {"9" * 5000}}}', "file"),
        ("[" * 100_000, "file"),
    ],
)
def test_an_invalid_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, field: str) -> None:
    (tmp_path / "a.json").write_text(text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInput) as refused:
        read_session(Path("a.json"))
    assert refused.value.field == field


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ({"op": "undo"}, "a.json, edits[1], op: 'undo' was given; allowed is one of set_prompt"),
        ({"op": "remove_prompts", "prompt_ids": [10**20]}, "a.json, edits[1], prompt_ids: [1000"),
        ({"op": "set_prompt", "text": "run", "prompt_id": [1]}, "a.json, edits[1], prompt_id: [1] was given"),
        (
            {"op": "add_constraints", "constraints": [LIMB | {"joints": ["LeftHand"]}]},
            "a.json, edits[1], joints: ('LeftHand',) was given; allowed is one index of the rig's joints or more",
        ),
        (
            {"op": "add_constraints", "constraints": [LIMB | {"joints": [-1]}]},
            "a.json, edits[1], joints: (-1,) was given",
        ),
    ],
)
def test_an_invalid_edit_is_refused_by_its_number(edit: dict[str, Any], said: str) -> None:
    written = {"format": FORMAT, "opening": {}, "num_frames": 20, "edits": [FIRST, {"at_frame": 7, **edit}]}
    with pytest.raises(InvalidInput) as refused:
        parse_session(json.dumps(written).encode(), "a.json")
    assert said in str(refused.value)


def test_more_edits_than_a_viewer_keeps_are_refused() -> None:
    edits = [{"at_frame": 0, "op": "clear_constraints"}] * (MOST_KEPT + 1)
    whole = {"format": FORMAT, "opening": {}, "num_frames": 20, "edits": edits}
    with pytest.raises(InvalidInput, match="20001 of them' was given; allowed is at most 20000"):
        parse_session(json.dumps(whole).encode(), "a.json")
    assert len(parse_session(json.dumps({**whole, "edits": edits[1:]}).encode(), "a.json").edits) == MOST_KEPT


async def test_the_edits_of_a_character_are_recorded(page: Page, room: Room, server: FakeServer) -> None:
    at_73 = session_pb2.EditOutcome(effective_frame=73)  # wherever the character is when the edit comes
    server.refuse = lambda event: at_73 if event.HasField("edit_prompts") else ""
    await page.ask(op="add", text="a person stands", steps=4)
    await page.ask(op="set_prompt", character=1, text="a person runs")
    await page.until(lambda: [e for e in page.last("character")["edits"] if e["state"] == "accepted"])
    written = session_of(room.character(1))
    assert written.opening["text"] == "a person stands"
    assert written.opening["seed"] == "7"
    (edit,) = written.edits
    assert (edit.message, edit.effective_frame) == ({"op": "set_prompt", "text": "a person runs"}, 73)


async def test_a_session_is_replayed(server: FakeServer) -> None:
    async with MotionClient(server.address) as client:
        session = await client.open("a person stands", keep_s=None)
        answers = await play(session, SESSION)
        assert [edit.message["op"] for edit, _ in answers] == ["set_prompt", "add_constraints"]
        assert len(session.motion(0, SESSION.num_frames)) == 60


async def test_an_edit_after_the_last_frame_is_reported_as_not_sent(server: FakeServer) -> None:
    late = SessionFile({}, 20, (ToldAt(4, 9, {"op": "clear_constraints"}), ToldAt(20, 30, {"op": "clear_constraints"})))
    async with MotionClient(server.address) as client:
        answers = await play(await client.open(keep_s=None), late)
    assert [edit.at_frame for edit, _ in answers] == [4, 20]
    assert answers[1][1] == "not sent: the motion ended before it"


async def test_an_invalid_edit_is_reported_when_replayed(server: FakeServer) -> None:
    wrong = SessionFile({}, 20, (ToldAt(4, 9, {"op": "dance"}),))
    async with MotionClient(server.address) as client:
        session = await client.open(keep_s=None)
        with pytest.raises(InvalidInput, match="edit at frame 4"):
            await play(session, wrong)
