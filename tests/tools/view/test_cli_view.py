"""`motiongen view` and `motiongen replay` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from motiongen_tools.cli import parse, run
from motiongen_tools.npz import read_npz
from motiongen_tools.view.session_file import SessionFile, ToldAt, write_session
from tests.client.fake_server import FakeServer


def test_view_listens_at_loopback_by_default() -> None:
    options = parse(["view"])
    assert (options.listen, options.port, options.token) == ("127.0.0.1", 8321, False)


def test_a_missing_three_js_is_reported_with_advice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["view", "--three", str(tmp_path)]) == 1
    assert "make viewer" in capsys.readouterr().err


@pytest.mark.parametrize("where", ["a..b", "x" * 70, "192.0.2.1"])
def test_an_address_that_is_not_of_this_machine_is_refused(
    where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "three.module.js").write_text("export {};")
    assert run(["view", "--server", "localhost:1", "--three", str(tmp_path), "--listen", where]) == 1
    assert "a free address of this machine" in capsys.readouterr().err


@pytest.mark.parametrize("port", ["65536", "99999", "-1", "x", "9" * 5000])
def test_an_invalid_port_is_refused(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["view", f"--port={port}"]) == 2
    assert "allowed is a whole number from 0 to 65535" in capsys.readouterr().err


def test_a_session_file_is_replayed_to_a_motion_file(
    server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edits = (ToldAt(2, 50, {"op": "set_prompt", "text": "a person runs"}),)
    (tmp_path / "a.session.json").write_text(write_session(SessionFile({"text": "a person stands"}, 70, edits)))
    out = tmp_path / "again.npz"
    assert run(["replay", str(tmp_path / "a.session.json"), "--server", server.address, "--out", str(out)]) == 0
    motion = read_npz(out)
    assert len(motion) == 70
    np.testing.assert_array_equal(np.unique(motion.rows[50:, 0]) > motion.rows[0, 0], True)
    assert "edits that took effect as recorded: 1 of 1" in capsys.readouterr().out


def test_an_output_of_a_replay_that_fails_does_not_prevent_the_others(
    server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.session.json").write_text(write_session(SessionFile({"text": "a person stands"}, 4, ())))
    outs = [str(tmp_path / name) for name in ("no_robot.csv", "again.npz")]
    asked = ["replay", str(tmp_path / "a.session.json"), "--server", server.address, "--out", outs[0], "--out", outs[1]]
    assert run(asked) == 1
    assert len(read_npz(outs[1])) == 4
    told = capsys.readouterr()
    assert "as recorded: 0 of 0" in told.out
    assert "error: no_robot.csv: the converter failed" in told.err


def test_a_file_that_is_not_a_session_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.json").write_text(json.dumps([1, 2]))
    assert run(["replay", str(tmp_path / "a.json")]) == 1
    assert "motiongen-session-1" in capsys.readouterr().err


def test_a_wrong_opening_is_reported_with_its_file_before_a_server_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.json").write_text(write_session(SessionFile({"steps": "four"}, 20, ())))
    assert run(["replay", "a.json", "--server", "localhost:1"]) == 1
    assert capsys.readouterr().err.startswith("error: a.json, opening, steps: 'four' was given; allowed is a whole")


def test_an_edit_that_the_rig_does_not_allow_is_reported_with_its_file_and_value(
    server: FakeServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    turn = {"op": "set_velocity", "x_mps": 0.0, "z_mps": 1.0, "heading_rad": 0.0}
    monkeypatch.setattr("motiongen_tools.view.session_file.read", lambda message: None)  # only found when it is due
    Path("a.json").write_text(write_session(SessionFile({}, 20, (ToldAt(4, 9, turn | {"z_mps": "fast"}),))))
    assert run(["replay", "a.json", "--server", server.address]) == 1
    assert "error: a.json, edit at frame 4, z_mps: 'fast' was given" in capsys.readouterr().err
