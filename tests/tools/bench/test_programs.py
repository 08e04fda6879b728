"""`motiongen bench --program` with programs that are missing or misbehave; tests/cpp has the real one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from motiongen_client import convert
from motiongen_tools.bench.load import GeneratorFailed, Load
from motiongen_tools.bench.programs import Programs, read_book
from motiongen_tools.bench.recorder import Recorder
from motiongen_tools.bench.scenario import load_scenario
from motiongen_tools.cli import run
from tests.client.synthetic import catalog


def write_program(folder: Path, body: str) -> Path:
    path = folder / "program"
    path.write_text(f"#!{sys.executable}\n{body}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("print('Usage: walk')", "is no motiongen-load: it said b'Usage: walk"),
        ("print(1)", "is no motiongen-load: it said b'1"),
        ("import sys; print(sys.stdin.readline())", "is no motiongen-load: it said b'{"),
        ("import sys; sys.stdin.readline()", "ended without a report"),
        ("""print('{"failed": "no motiongen server answers at a:1"}')""", "^no motiongen server answers at a:1$"),
    ],
)
async def test_a_program_that_fails_is_reported_with_the_reason(
    body: str, why: str, short_scenario: Path, tmp_path: Path
) -> None:
    program = write_program(tmp_path, body)
    load = Load("a:1", load_scenario(str(short_scenario)), characters=3, seconds=1, seed=1, program=program)
    with pytest.raises(GeneratorFailed, match=why):
        async with Programs(load, convert.catalog(catalog(20))) as programs:
            await programs.ready()


def test_a_missing_program_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nowhere = str(tmp_path / "motiongen-load")
    assert run(["bench", "--server", "localhost:1", "--program", nowhere, "--out", str(tmp_path)]) == 1
    assert f"--program: '{nowhere}' was given; allowed is a motiongen-load" in capsys.readouterr().err


def test_results_of_a_program_are_read_like_those_of_a_recorder() -> None:
    ours = Recorder(("near",), 2)
    for milliseconds in (1, 1, 2, 300):
        ours.record("chunk_slack", "near", milliseconds / 1000)
    ours.counts["plans"] = 3
    ours.add("frames", "near", 1.5, 20)
    seconds = [{"what": what, "group": "near", "amount": rows["near"]} for what, rows in ours.seconds.items()]
    latencies = {"what": "chunk_slack", "group": "near", "value_us": [1000, 2000, 299776], "count": ["2", "1", "1"]}
    packed = read_book({"latencies": [latencies], "counts": {"plans": "3"}, "seconds": seconds})
    assert packed == ours.pack()
