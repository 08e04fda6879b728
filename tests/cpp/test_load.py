"""motiongen-load: the load of `motiongen bench`, played by a C++ program with the same report."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from motiongen_tools.cli import run
from tests.bench.null_process import NULL_SERVER, SETTINGS, server_process

SCENARIO = """
format: 1
name: short
revision: 1
description: Everything that a character may be told, by those who stay and those who pass.
characters: 24
characters_per_stream: 10
ramp_s: 0.5
settle_s: 0.5
tail_s: 1
groups:
  - name: hero
    share: 0.25
    priority: HERO
    prompts: [walk, run away]
    edits:
      - {kind: velocity, every_s: 0.2, speed_m_s: 1.4}
      - {kind: prompt, every_s: 0.5, timing: together}
  - name: passing
    share: 0.75
    priority: CROWD
    life: {median_s: 1.5, sigma: 0.5}
    prompts: [walk, stand]
    edits:
      - {kind: constraints, every_s: 0.5, timing: random, waypoints: 3}
      - {kind: prompt, every_s: 0.7}
"""
TIMED = ("counts", "figures", "latencies_ms", "by_second", "histograms")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with server_process(NULL_SERVER, *SETTINGS) as server:
        yield server.address


def play(address: str, tmp_path: Path, name: str, *more: str) -> dict[str, Any]:
    scenario = tmp_path / "short.yaml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    load = ["--server", address, "--scenario", str(scenario), "--seconds", "3", "--seed", "4", "--max-lag-ms", "60000"]
    assert run(["bench", *load, "--out", str(tmp_path / name), *more]) == 0
    document: dict[str, Any] = json.loads((tmp_path / name / "result.json").read_text())["result"]
    return document


def test_cpp_and_python_generators_play_and_report_the_same_load(
    program: Callable[[str], Path], address: str, tmp_path: Path
) -> None:
    in_cpp = play(address, tmp_path, "cpp", "--program", str(program("motiongen-load")), "--processes", "2")
    in_python = play(address, tmp_path, "python", "--processes", "2")
    assert in_cpp["generator"]["program"].startswith("motiongen-load ")
    assert in_python["generator"]["program"] == "motiongen_tools"
    assert list(in_cpp) == list(in_python)
    for name in in_cpp:
        if isinstance(in_cpp[name], dict) and name not in TIMED:
            assert list(in_cpp[name]) == list(in_python[name])
    for name in ("scenario", "load", "phases", "server", "machine"):
        assert in_cpp[name] == in_python[name]
    measured = range(4)
    # The intended load is the same to the last edit, but in the tail, edits that are late are not played.
    for name in ("opens", "edits"):
        ours, theirs = (each["by_second"][name] for each in (in_cpp, in_python))
        assert len(ours) == len(theirs)
        assert [ours[second] for second in measured] == [theirs[second] for second in measured]
    for group, figures in in_cpp["figures"].items():
        assert list(figures) == list(in_python["figures"][group])
    for what, latencies in in_cpp["latencies_ms"].items():
        for group, summary in latencies.items():
            theirs = in_python["latencies_ms"][what][group]
            assert not (summary["count"] and theirs["count"]) or list(summary) == list(theirs)
    assert min(each["round_trip_ms"]["count"] for each in (in_cpp, in_python)) > 0
    # how much is played depends on the load of the machine: about as much in both
    for what in ("open_to_first_frame", "event_to_first_frame", "event_to_answer"):
        counts = [each["latencies_ms"][what]["all"]["count"] for each in (in_cpp, in_python)]
        assert min(counts) > max(counts) / 2 > 10
    due = [sum(each["by_second"]["due"]) for each in (in_cpp, in_python)]
    assert min(due) > max(due) / 2 > 100
    # one sample every 10 ms for each process, however many streams it has and however long it stalls
    for each in (in_cpp, in_python):
        assert 0 < each["generator"]["loop_lag_ms"]["count"] <= 2 * (100 * 3 + 1)
    against_us = ("refused", "stream", "protocol", "sessions_lost")
    assert not [name for name in in_cpp["counts"] if name.startswith(against_us)]
    assert {"chunk_slack/hero", "event_to_screen/passing", "write_wait/generator"} <= in_cpp["histograms"].keys()


def test_report_counts_sessions_lost_when_the_server_stops(program: Callable[[str], Path]) -> None:
    command = [program("motiongen-load")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as load:
        assert load.stdin is not None
        assert load.stdout is not None
        with server_process(NULL_SERVER, *SETTINGS) as server:
            message = {"address": server.address, "num_processes": 1, "num_streams": 1, "max_request_bytes": 65536}
            message |= {"frame_rate": 20, "patch_frames": 4, "report_hz": 4, "measure_to_s": 6, "end_s": 6}
            message |= {"groups": [{"name": "g", "prompts": ["walk"]}], "jitter_s": [0]}
            message |= {"characters": [{"open_s": 0, "seed": "7"}, {"open_s": 4.5, "seed": "8"}]}
            load.stdin.write(json.dumps(message) + "\n")
            load.stdin.flush()
            assert "ready" in json.loads(load.stdout.readline())
            load.stdin.write(json.dumps({"start_at_s": time.monotonic()}) + "\n")
            load.stdin.flush()
            while not json.loads(load.stdout.readline())["progress"]["playing"]:
                pass
        *_, last = load.stdout
    book = json.loads(last)["book"]
    counts = book["counts"]
    assert counts["sessions_opened"] == counts["opens_not_sent"] == counts["characters_without_a_frame"] == "1"
    (waited,) = (each for each in book["latencies"] if each["what"] == "open_to_first_frame")
    assert sum(map(int, waited["count"])) == 2
    assert max(waited["value_us"]) == pytest.approx(1.5e6, rel=0.01), (
        "a session that was not opened has waited to the end"
    )
    assert sum(int(count) for name, count in counts.items() if name.startswith("sessions_lost: ")) == 1


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("walk", "is no load"),
        ('{"num_processes": 1}', "0 streams"),
        ('{"address": "localhost:1", "num_processes": 1, "num_streams": 1, "max_request_bytes": 9, "frame_rate": 20,'
         '"report_hz": 4, "end_s": 1, "jitter_s": [0], "edit_at_s": [1], "edit_character": [3], "edit_rule": [0],'
         '"edit_value": [0]}', "edit 0 is of character 3, which is not there"),
        ('{"address": "localhost:1", "num_processes": 1, "num_streams": 1, "max_request_bytes": 9, "frame_rate": 20,'
         '"report_hz": 4, "end_s": 1, "jitter_s": [0]}', "no motiongen server answers at localhost:1"),
        ('{"address": "localhost:1", "num_processes": 1, "num_streams": 1, "max_request_bytes": 9, "frame_rate": 20,'
         '"report_hz": 4, "end_s": 1, "jitter_s": [0], "access": {"token": "abc\\n"}}', "the byte 0x0a at position 3"),
        ('{"address": "10.0.0.7:1", "num_processes": 1, "num_streams": 1, "max_request_bytes": 9, "frame_rate": 20,'
         '"report_hz": 4, "end_s": 1, "jitter_s": [0], "access": {"token": "abc"}}', "without TLS"),
    ],
)  # fmt: skip
def test_invalid_load_fails_with_the_reason(program: Callable[[str], Path], line: str, why: str) -> None:
    done = subprocess.run(
        [program("motiongen-load")], input=line + "\n", stdout=subprocess.PIPE, text=True, check=False
    )
    assert done.returncode == 1
    assert why in json.loads(done.stdout.splitlines()[-1])["failed"]
