"""Clips of a real server: equal to what a session shows, beside a session, and as files in every format."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motiongen_ardy.formats.files import read_motion
from motiongen_client import (
    DeadlineExceeded,
    EventRefused,
    InvalidInput,
    Motion,
    MotionClient,
    SessionOptions,
    StartPose,
    Waypoint,
)
from motiongen_tools.cli import run
from motiongen_tools.npz import read_npz
from tests.conftest import ROOT, LiveServer
from tests.waiting import LIMIT_S

G1_MODEL = ROOT / "tests" / "data" / "golden" / "tiny-g134" / "checkpoint"


async def test_clip_equals_the_start_of_a_session_with_the_same_seed(live_server: LiveServer) -> None:
    options = SessionOptions(seed=11, denoise_steps=4, start=StartPose(1.0, 2.0, 0.5))
    async with asyncio.timeout(LIMIT_S), MotionClient(live_server.address) as client:
        (clip,) = await client.generate_clip("a person walks", num_frames=100, options=options)
        session = await client.open("a person walks", options=options)
        _ = [frame async for frame in session.frames(seconds=2, realtime=False)]
        shown = session.motion()
    assert clip.seed == 11
    # Both consist of the same windows until a session's window is shortened to spread sessions out over time.
    np.testing.assert_allclose(clip.motion.rows[:40], shown.rows[:40], atol=1e-4)


async def test_samples_differ_and_a_session_plays_beside_them(live_server: LiveServer) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(live_server.address) as client:
        session = await client.open("a person walks")
        asked = client.generate_clip("a person walks", num_frames=400, num_samples=8, options=SessionOptions(seed=5))
        making = asyncio.create_task(asked)
        played = [frame.index async for frame in session.frames(seconds=2)]
        clips = await making
    assert played == list(range(40))
    assert [clip.seed for clip in clips] == list(range(5, 13))
    assert all(np.isfinite(clip.motion.rows).all() and len(clip.motion) == 400 for clip in clips)
    assert len({clip.motion.rows.tobytes() for clip in clips}) == 8


async def test_motion_continues_from_prior_frames(live_server: LiveServer) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(live_server.address) as client:
        far_away = SessionOptions(seed=1, start=StartPose(300.0, -200.0))
        (first,) = await client.generate_clip("a person walks", num_frames=40, options=far_away)
        prior = Motion(first.motion.rig, 0, first.motion.rows[-24:])
        options = SessionOptions(seed=2, prior=prior, history_frames=24)
        (clip,) = await client.generate_clip("a person walks", num_frames=40, options=options)
        session = await client.open("a person walks", options=options)
        _ = [frame async for frame in session.frames(seconds=1, realtime=False)]
        shown = session.motion()
        too_short = SessionOptions(prior=Motion(prior.rig, 0, prior.rows[:3]))
        with pytest.raises(EventRefused) as refused:
            await client.generate_clip(num_frames=40, options=too_short)
    gap_m = np.linalg.norm(clip.motion.root_translation_m[0] - prior.root_translation_m[-1])
    assert gap_m < 5.0, "random weights jump, but not by 300 m"
    np.testing.assert_allclose(shown.rows[:20], clip.motion.rows[:20], atol=1e-4)
    assert (refused.value.reason, refused.value.field) == (
        "PRIOR_FRAMES_OUT_OF_RANGE",
        "open.prior_frames.frame_count",
    )
    assert refused.value.allowed.startswith("multiples of 4")


async def test_deadlines_and_invalid_requests_raise_their_own_errors(live_server: LiveServer) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(live_server.address) as client:
        with pytest.raises(DeadlineExceeded):
            await client.generate_clip("a person walks", num_frames=2400, num_samples=16, timeout_s=0.05)
        with pytest.raises(InvalidInput):
            await client.generate_clip("a person walks", num_frames=2401)
        with pytest.raises(EventRefused) as refused:
            await client.generate_clip(num_frames=40, constraints=[Waypoint(40, 0.0, 1.0)])
        assert refused.value.reason == "CONSTRAINT_OUTSIDE_CLIP"
        (clip,) = await client.generate_clip(num_frames=40, constraints=[Waypoint(39, 0.0, 1.0, 0.1)])
    residual = clip.residuals[0]
    assert residual.position_m is not None
    assert residual.heading_rad is not None
    missed_m = np.linalg.norm(clip.motion.root_translation_m[39, [0, 2]] - [0.0, 1.0])
    assert residual.position_m.worst == pytest.approx(missed_m, abs=1e-5)


def test_person_is_written_in_every_format(
    live_server: LiveServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["generate", "a person walks", "--at", "1", "--prompt", "a person runs", "--seconds", "2.5", "--seed", "3"]
    line += ["--server", live_server.address.replace("localhost", "127.0.0.1"), "--waypoint", "0,1@2"]
    names = ("walk.npz", "walk.bvh", "walk.glb", "walk.json")
    files = [argument for name in names for argument in ("--out", str(tmp_path / name))]
    assert run([*line, *files]) == 0, capsys.readouterr().err
    told = json.loads((tmp_path / "walk.json").read_text())
    assert told["prompt"] == "a person walks; then a person runs"
    assert told["samples"][0]["residuals"][0]["constraint"] == "waypoint at frame 40"
    assert "waypoint at frame 40" in capsys.readouterr().out
    for name in names[:2]:
        assert read_motion(tmp_path / name).motion.num_frames == 50
    extras = glb_json(tmp_path / "walk.glb")["animations"][0]["extras"]
    assert extras == {"text": "a person walks; then a person runs", "frames_per_second": 20}
    assert run([*line, "--samples", "2", "--out", str(tmp_path / "run.npz")]) == 0
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["run_00.npz", "run_01.npz"]
    assert run([*line, "--out", str(tmp_path / "walk.csv")]) == 1, "csv files are for robots only"
    assert "walk.csv" in capsys.readouterr().err


def glb_json(path: Path) -> Any:
    """The JSON chunk of a binary glTF, its first one."""
    content = path.read_bytes()
    magic, length, kind = content[:4], int.from_bytes(content[12:16], "little"), content[16:20]
    assert (magic, kind) == (b"glTF", b"JSON")
    return json.loads(content[20 : 20 + length])


def test_robot_is_written_in_every_format_and_continued_from_its_state(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server = ["--start-server", "--", "--model", str(G1_MODEL), "--text-encoder", "hashed"]
    server += ["--devices", "cpu:1", "--precision", "float32", "--profile-s", "0.1"]
    names = ("g1.csv", "g1.controller.csv", "g1.npz", "g1.bvh", "g1.glb")
    files = [argument for name in names for argument in ("--out", str(tmp_path / name))]
    assert run(["generate", "walk", "--seconds", "2", "--rate-hz", "50", *files, *server]) == 0, capsys.readouterr().err
    assert len(np.loadtxt(tmp_path / "g1.csv", delimiter=",")) == 50
    for name in names[:4]:
        assert read_motion(tmp_path / name).motion.num_frames >= 50
    line = ["generate", "walk", "--seconds", "1", "--history", str(tmp_path / "g1.csv"), "--history-frames", "8"]
    assert run([*line, "--out", str(tmp_path / "on.npz"), *server]) == 0, capsys.readouterr().err
    with np.load(tmp_path / "on.npz") as on:
        assert on["local_rot_mats"].shape == (25, 34, 3, 3)


def test_npz_file_of_the_client_can_be_history(live_server: LiveServer, tmp_path: Path) -> None:
    address = live_server.address
    stream = ["stream", "--prompt", "walk", "--seconds", "1", "--npz", "--out", str(tmp_path / "a.bvh")]
    assert run([*stream, "--server", address]) == 0
    assert len(read_npz(tmp_path / "a.npz")) == 20
    line = ["generate", "walk", "--history", str(tmp_path / "a.npz"), "--out", str(tmp_path / "b.npz")]
    assert run([*line, "--seconds", "1", "--server", address]) == 0
