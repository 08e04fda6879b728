"""The core: its own unit tests, and its playback compared with the Python client's, call by call."""

from __future__ import annotations

import random
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motiongen_client.errors import InvalidInput, ProtocolViolation
from motiongen_client.playback import Playback

RATE = 20.0
WIDTH = 2


def test_unit_tests_of_the_core_pass(program: Callable[[str], Path], tmp_path: Path) -> None:
    subprocess.run([program("core_tests"), "--gtest_brief=1"], check=True, cwd=tmp_path)


class PythonTimeline:
    """The Python client's playback, which takes the same lines as `timeline_trace`, and answers in the same form."""

    def __init__(self, new: str) -> None:
        start, keep = map(int, new.split()[-2:])
        self.playback = Playback(RATE, WIDTH, start_frame=start, keep_frames=None if keep < 0 else keep)

    def call(self, line: str) -> str:
        name, *numbers = line.split()
        return f"{self._answer(name, numbers)} {self._state()}"

    def _answer(self, name: str, numbers: list[str]) -> str:
        playback = self.playback
        try:
            match name:
                case "plan":
                    playback.announce_plan(int(numbers[0]), int(numbers[1]), is_cut=numbers[2] == "1")
                case "chunk":
                    plan, first, count, committed = map(int, numbers)
                    rows = np.repeat(plan * 1000 + np.arange(first, first + count)[:, None], WIDTH, axis=1)
                    if count < 1:
                        return "-"  # the client refuses it before it reaches playback
                    playback.add_chunk(plan, first, rows.astype(np.float32), committed)
                case "cut":
                    return str(playback.note_cut(int(numbers[0])))
                case "advance":
                    return shown(playback.advance(float(numbers[0])))
                case "to":
                    return shown(playback.advance_to(int(numbers[0])))
                case "pause":
                    playback.pause()
                case "resume":
                    playback.resume()
                case "scale":
                    playback.set_time_scale(float(numbers[0]))
                case "anew":
                    playback.restart(playback.buffered_to)
        except (InvalidInput, ProtocolViolation):
            return "-"
        return "ok"

    def _state(self) -> str:
        playback = self.playback
        held = range(playback.first_kept, playback.buffered_to)
        total = sum(float(playback.row(frame)[0]) for frame in held)
        newest_cut = playback.cut_before(playback.buffered_to + 1) or 0
        return (
            f"{playback.playhead} {playback.buffered_to} {playback.first_kept} {playback.committed_to} "
            f"{playback.underruns} {playback.late_plans} {total:.0f} {newest_cut} "
            f"{playback.received_to} {playback.plan}"
        )


def shown(reached: range) -> str:
    return f"{reached.start if reached else 0}+{len(reached)}"


def draw_trace(seed: int) -> list[str]:
    """A session in which much goes wrong: late plans, gaps, holds, pauses, losses, messages that break the rules."""
    draw = random.Random(seed)
    lines = [f"new {RATE} {WIDTH} {draw.choice([0, 0, 1000])} {draw.choice([-1, 0, 3, 30])}"]
    played, now_s = PythonTimeline(lines[0]), 0.0

    def say(line: str) -> None:
        lines.append(line)
        played.call(line)

    often = {"plan": 2.0, "chunk": 6.0, "advance": 12.0, "resume": 2.0}
    calls = often | dict.fromkeys(("to", "pause", "break", "scale"), 1.0) | {"anew": 0.3}
    for _ in range(200):
        playback = played.playback
        plan, received, committed = playback.plan, playback.received_to, playback.committed_to
        match draw.choices(list(calls), list(calls.values()))[0]:
            case "plan":
                valid_from = draw.randint(committed, max(received, committed)) if draw.random() < 0.8 else received + 2
                say(f"plan {plan + 1} {valid_from} {int(draw.random() < 0.2)}")
                if draw.random() < 0.2:  # known from its outcome, after a loss
                    say(f"cut {valid_from + draw.randint(0, 3)}")
            case "chunk":
                promised = draw.randint(committed, max(received, committed)) if draw.random() < 0.3 else committed
                say(f"chunk {plan} {received} {draw.randint(1, 12)} {promised}")
            case "advance":
                now_s += draw.choice([0.0, 1 / 60, 0.05, 0.05, 0.1, 0.35])
                say(f"advance {now_s!r}")
            case "to":
                say(f"to {draw.randint(max(playback.playhead - 2, 0), playback.buffered_to + 1)}")
            case "scale":
                say(f"scale {draw.choice([0.5, 1, 1, 2, 0, -1])}")
            case "break":
                broken = [f"plan {max(plan, 1)} {received} 0", f"chunk {plan} {received + 1} 2 {committed}"]
                broken += [f"chunk {plan + 1} {received} 2 {committed}", f"chunk {plan} {received} 0 {committed}"]
                say(draw.choice(broken))
            case other:
                say(other)
    return lines


def trace(program: Callable[[str], Path], lines: list[str]) -> list[str]:
    told = subprocess.run(
        [program("timeline_trace")], input="\n".join(lines), stdout=subprocess.PIPE, text=True, check=True
    )
    return told.stdout.splitlines()


@pytest.mark.parametrize("seed", range(40))
def test_playback_equals_the_python_clients(program: Callable[[str], Path], seed: int) -> None:
    lines = draw_trace(seed)
    python = PythonTimeline(lines[0])
    told = trace(program, lines)
    assert len(told) == len(lines)
    for number, (line, answer) in enumerate(zip(lines[1:], told[1:], strict=True), 1):
        assert answer == python.call(line), f"call {number}: {line}"


def test_playback_traces_contain_refusals_underruns_and_late_plans(program: Callable[[str], Path]) -> None:
    answers = [line.split() for seed in range(40) for line in trace(program, draw_trace(seed))]
    refused = sum(answer[0] == "-" for answer in answers)
    assert refused > 100
    assert max(int(answer[5]) for answer in answers) > 10, "underruns"
    assert max(int(answer[6]) for answer in answers) > 3, "late plans"
    lines = [line for seed in range(40) for line in draw_trace(seed)]
    for name in ("scale", "anew"):
        assert sum(line.startswith(name) for line in lines) > 20
    asked_at = [line.split()[1] for line in lines if line.startswith("cut")]
    told_at = [answer[0] for line, answer in zip(lines, answers, strict=True) if line.startswith("cut")]
    assert sum(told != asked for told, asked in zip(told_at, asked_at, strict=True)) > 5, "cuts that were passed"
