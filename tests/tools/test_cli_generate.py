"""`motiongen generate` without a server: its arguments, prompts by frame, and files that can or cannot be written."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
import pytest

from motiongen_client import InvalidInput, Motion, Rig
from motiongen_client.types import Clip
from motiongen_tools import cli_generate, out_files
from motiongen_tools.cli import parse, run
from motiongen_tools.cli_generate import write_clips
from motiongen_tools.cli_script import Script
from motiongen_tools.cli_stream import TimedWaypoint
from motiongen_tools.conversion import ConversionFailed
from motiongen_tools.out_files import check_out, sample_paths


@pytest.mark.parametrize("command", ["generate", "stream"])
def test_waypoints_may_have_negative_coordinates(command: str) -> None:
    options = parse([command, "--waypoint", "-1,2,1.57@5", "--waypoint", "-.5,-2@3", "--waypoint=-3,0@1"])
    assert options.waypoint == [
        TimedWaypoint(5.0, -1.0, 2.0, 1.57), TimedWaypoint(3.0, -0.5, -2.0), TimedWaypoint(1.0, -3.0, 0.0),
    ]  # fmt: skip


def test_an_option_is_not_taken_as_a_waypoint(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["stream", "--waypoint", "--png"]) == 2
    assert "argument --waypoint: expected one argument" in capsys.readouterr().err


def test_a_prompt_just_before_the_end_starts_at_the_last_frame(stick_rig: Rig) -> None:
    just_before_s = 1 - 0.1 / stick_rig.frame_rate_hz
    prompts = Script([(0.0, "walk"), (just_before_s, "run")]).in_frames(stick_rig, stick_rig.frame_rate_hz)
    assert prompts == {0: "walk", stick_rig.frame_rate_hz - 1: "run"}


def test_two_prompts_at_one_frame_are_refused(stick_rig: Rig) -> None:
    script = Script([(0.0, "walk"), (0.1 / stick_rig.frame_rate_hz, "run")])
    with pytest.raises(InvalidInput, match=r"--at: .* allowed is a time of another frame"):
        script.in_frames(stick_rig, 100)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("--rate-hz 50 --out walk.csv", "--rate-hz is for .controller.csv"),
        ("--rate-hz 50", "--rate-hz is for .controller.csv"),
        ("--history-hz 50", "--history-hz is for the CSV of a G1"),
        ("--history-hz 50 --history walk.bvh", "--history-hz is for the CSV of a G1"),
        ("--history-hz 50 --history g1.controller.csv", "--history-hz is for the CSV of a G1 without a clock"),
    ],
)
def test_an_option_without_effect_is_refused(
    arguments: str, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["generate", "walk", *arguments.split()]) == 2
    assert complaint in capsys.readouterr().err


def test_options_with_effect_are_accepted() -> None:
    assert parse(["generate", "walk", "--rate-hz", "50", "--out", "a.npz", "--out", "b.controller.csv"]).rate_hz == 50
    assert parse(["generate", "walk", "--history-hz", "50", "--history", "a.csv"]).history_hz == 50


@pytest.mark.parametrize("option", ["--constraints", "--history"])
@pytest.mark.parametrize("file", ["no such file", "."])
def test_unreadable_input_is_refused_before_a_server_is_started(
    option: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli_generate, "ServerProcess", lambda *_, **__: pytest.fail("a server is started"))
    out = ["--out", str(tmp_path / "walk.npz")]
    assert run(["generate", "walk", "--start-server", option, str(tmp_path / file), *out]) == 1
    assert capsys.readouterr().err.startswith(f"error: {option}: ")


@pytest.mark.parametrize("out", ["again.json", "again.fbx", ".npz"])
def test_replay_writes_only_motion_formats(out: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["replay", "a.session.json", "--out", out]) == 2
    allowed = capsys.readouterr().err.rpartition("allowed is ")[2]
    assert allowed == "a name that ends in .controller.csv, .csv, .npz, .bvh, .glb\n"


def test_output_paths_are_checked_for_a_limited_number_of_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked_at: list[int] = []

    def paths(path: Path, num_samples: int) -> list[Path]:
        looked_at.append(num_samples)
        return sample_paths(path, num_samples)

    monkeypatch.setattr(out_files, "sample_paths", paths)
    check_out(tmp_path / "walk.npz", 10**12)
    assert looked_at == [out_files.MOST_CHECKED]


async def test_a_file_that_cannot_be_written_does_not_prevent_the_others(
    stick_motion: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(source: Path, target: Path, *options: str, source_name: str) -> list[str]:
        raise ConversionFailed(f"{target.name}: the converter failed")

    monkeypatch.setattr(cli_generate, "convert_file", refuse)
    clip, rig = Clip("fake", 1, 4, stick_motion, ()), stick_motion.rig
    model = argparse.Namespace(model_id="fake", rig_id=rig.rig_id, licence="CC0-1.0", patch_frames=4)
    limits = argparse.Namespace(max_trajectory_frames=100, max_clip_frames=200)
    catalog = argparse.Namespace(models=[model], rig=lambda _: rig, limits=limits)

    class Client:
        async def __aenter__(self) -> argparse.Namespace:
            return argparse.Namespace(catalog=catalog, generate_clip=self.generate)

        async def __aexit__(self, *_: object) -> None:
            pass

        async def generate(self, **_: object) -> list[Clip]:
            return [clip]

    monkeypatch.setattr(cli_generate, "client_of", lambda *_: Client())
    outs = [str(tmp_path / name) for name in ("walk.csv", "walk.npz", "walk.json")]
    options = parse(["generate", "walk", *(word for out in outs for word in ("--out", out))])
    assert await cli_generate.generate(options) == 1
    assert sorted(os.listdir(tmp_path)) == ["walk.json", "walk.npz"]
    assert capsys.readouterr().err == "error: walk.csv: the converter failed\n"


def test_every_sample_is_written(stick_motion: Motion, tmp_path: Path) -> None:
    clips = [Clip("fake", seed, 4, stick_motion, ()) for seed in (1, 2)]
    written = [path for path, _ in write_clips(tmp_path / "walk.npz", clips, [], "walk", None)]
    assert written == [tmp_path / "walk" / "walk_00.npz", tmp_path / "walk" / "walk_01.npz"]
    with np.load(written[1]) as arrays:
        assert len(arrays["root_positions"]) == len(stick_motion)
