"""Tokens kept for history against history encoded again: `python -m tests.bench.history --out out/bench`.

Which is faster, and which has the smaller seams. A seam is where one window's frames meet the next's; its size is how
far the first frames after it are from where the two before them were heading, in centimetres: of the root, and of all
joints on average. What the same measure gives within windows stands beside it: more than that is seen as a jerk.
Windows follow each other after 40 frames, as they do when nobody edits, after 24, as after an edit on the grid of the
tokens, and after 26, as after an edit at any frame, where only encoding again is possible.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from motiongen_server.engine.types import Float32Array, Waypoint, WindowJob, WindowResult
from motiongen_server.runner import TorchRunner
from tests.bench.clocks import WallClock
from tests.bench.machine import machine_facts, usable_cores
from tests.bench.models import BUILT_IN, BenchModel, bench_model
from tests.bench.offline import HISTORY_FRAMES, first_job, offline_rate

CASES = ((40, True), (40, False), (24, True), (24, False), (26, False))
BATCHES = (1, 8, 32)


@dataclass(frozen=True)
class Seams:
    """Of windows that follow each other every `stride` frames. (mean, 95th percentile) in centimetres a frame squared.

    kept: whether histories are the kept tokens; inside: the same within windows.
    """

    stride: int
    kept: bool
    root_cm: tuple[float, float]
    root_inside_cm: tuple[float, float]
    joints_cm: tuple[float, float]
    joints_inside_cm: tuple[float, float]


@dataclass(frozen=True)
class Speed:
    """Milliseconds to prepare a batch of windows, and windows a second over all, with tokens and without."""

    batch: int
    prepare_ms: tuple[float, float]
    windows_per_s: tuple[float, float]


class Character:
    """What a character has done so far: features, and tokens for as long as they lie on one grid."""

    def __init__(self, first: WindowJob, stride: int, kept: bool) -> None:
        self._first = first
        self._stride = stride
        self._kept = kept
        self._windows = 0
        self.features: Float32Array = np.empty((0, 0), np.float32)
        self._tokens: Float32Array = np.empty((0, 0), np.float32)

    def next_job(self, job_id: int) -> WindowJob:
        done = len(self.features)
        if not done:
            return replace(self._first, job_id=job_id)
        return replace(
            self._first,
            job_id=job_id,
            plan=self._windows + 1,
            first_frame=done,
            history=self.features[-HISTORY_FRAMES:],
            start_pose=None,
            history_tokens=self._tokens[-HISTORY_FRAMES // 4 :] if self._kept else None,
        )

    def take(self, result: WindowResult) -> None:
        assert result.tokens is not None
        features, tokens = result.features[: self._stride], result.tokens[: self._stride // 4]
        self._windows += 1
        self.features = features if self._windows == 1 else np.concatenate([self.features, features])
        self._tokens = tokens if self._windows == 1 else np.concatenate([self._tokens, tokens])


def walk(runner: TorchRunner, characters: Sequence[Character], num_windows: int) -> Float32Array:
    """Features (B, T, D) of all characters, denoised together."""
    for _ in range(num_windows):
        jobs = [character.next_job(number) for number, character in enumerate(characters)]
        ids = [job.job_id for job in jobs]
        runner.prepare(jobs)
        for _ in range(jobs[0].num_steps):
            runner.denoise(ids)
        for character, result in zip(characters, runner.decode(ids), strict=True):
            character.take(result)
    return np.stack([character.features for character in characters])


def make_characters(chosen: BenchModel, count: int, num_steps: int, stride: int, kept: bool) -> list[Character]:
    """Every other one has a waypoint far ahead, the others a prompt alone."""
    jobs = []
    for number in range(count):
        job = first_job(number, num_steps, chosen.embeddings)
        if number % 2:
            job = replace(job, constraints=(Waypoint(1, 150, 0.5 * (number % 5) - 1.0, 4.0),))
        jobs.append(job)
    return [Character(job, stride, kept) for job in jobs]


def seams(chosen: BenchModel, features: Float32Array, stride: int, kept: bool) -> Seams:
    """How far each frame is from where the two before it were heading, at borders and elsewhere."""
    layout = chosen.model.representation
    with torch.inference_mode():
        motion = layout.motion(layout.denormalize(torch.from_numpy(features)))
        joints = motion.positions(chosen.model.skeleton)
    # Frame f is at f - 2 here. The two frames after a border are those whose past reaches across it.
    root_cm, joints_cm = (
        100 * torch.linalg.vector_norm(torch.diff(positions, n=2, dim=1), dim=-1)
        for positions in (motion.root_positions, joints)
    )
    frames = torch.arange(2, features.shape[1])
    across = (frames % stride < 2) & (frames >= stride)

    def spread(values: torch.Tensor) -> tuple[float, float]:
        return float(values.mean()), float(values.flatten().quantile(0.95))

    joints_cm = joints_cm.mean(-1)
    return Seams(
        stride,
        kept,
        spread(root_cm[:, across]),
        spread(root_cm[:, ~across]),
        spread(joints_cm[:, across]),
        spread(joints_cm[:, ~across]),
    )


def speed(runner: TorchRunner, chosen: BenchModel, batch: int, num_steps: int, seconds: float) -> Speed:
    kept, encoded = (
        offline_rate(runner, batch, num_steps, chosen.embeddings, seconds, WallClock(), keep_tokens=keep)
        for keep in (True, False)
    )
    return Speed(batch, (1000 * kept.prepare_s, 1000 * encoded.prepare_s), (kept.windows_per_s, encoded.windows_per_s))


def markdown(facts: dict[str, str], speeds: Sequence[Speed], found: Sequence[Seams]) -> str:
    def pair(values: tuple[float, float]) -> str:
        return f"{values[0]:.2f} / {values[1]:.2f}"

    lines = ["| batch | prepare, tokens kept / encoded again | windows/s, kept / again |", "|---:|---:|---:|"]
    for each in speeds:
        kept, again = each.windows_per_s
        lines.append(f"| {each.batch} | {pair(each.prepare_ms)} ms | {kept:.1f} / {again:.1f} |")
    lines += [
        "",
        "| window every | history | root at seams, mean / p95 | root within | joints at seams, mean / p95 "
        "| joints within |",
        "|---:|---|---:|---:|---:|---:|",
    ]
    for one in found:
        history = "tokens kept" if one.kept else "encoded again"
        cells = (one.root_cm, one.root_inside_cm, one.joints_cm, one.joints_inside_cm)
        lines.append(f"| {one.stride} frames | {history} | " + " | ".join(f"{pair(cell)} cm" for cell in cells) + " |")
    return "\n".join([*lines, "", *(f"- {name}: {value}" for name, value in facts.items()), ""])


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.history", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder to write to (default: print only)")
    parser.add_argument("--model", default=BUILT_IN, help='checkpoint folder, "full" or "tiny" (default: %(default)s)')
    parser.add_argument("--steps", type=int, default=4, help="denoising steps (default: %(default)s)")
    parser.add_argument("--characters", type=int, default=32, help="for the seams (default: %(default)s)")
    parser.add_argument("--windows", type=int, default=6, help="of each character (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=1.5, help="for each speed (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=usable_cores(), help="of torch (default: one for each core)")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    facts, chosen = machine_facts(), bench_model(options.model)
    runner = TorchRunner(chosen.model, chosen.name)
    speeds = [speed(runner, chosen, batch, options.steps, options.seconds) for batch in BATCHES]
    found = []
    for stride, kept in CASES:
        characters = make_characters(chosen, options.characters, options.steps, stride, kept)
        found.append(seams(chosen, walk(runner, characters, options.windows), stride, kept))
    table = markdown(facts, speeds, found)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        report = {"facts": facts, "speed": [asdict(each) for each in speeds], "seams": [asdict(one) for one in found]}
        (options.out / "history.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        (options.out / "history.md").write_text(table, encoding="utf-8")
    print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
