"""What a model must be able to do: `python -m motiongen_ardy.evaluate.gate MODEL DATA`.

Prints a table, writes the figures as JSON if asked, and exits with 1 when a figure misses its bound.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from motiongen_ardy.checkpoint import load_checkpoint
from motiongen_ardy.constraint import Targets
from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.denoiser.guidance import GuidanceWeights
from motiongen_ardy.evaluate.generate import generate_batch
from motiongen_ardy.evaluate.measures import foot_sliding, hand_raised, joint_error, travel
from motiongen_ardy.model import Model
from motiongen_ardy.model_card import model_folder
from motiongen_ardy.text import TextEncoder, load_text_encoder
from motiongen_ardy.train.feature_bank import FeatureBank, build_feature_bank, natural_layout

SEEDS = range(20)
HISTORY = 16
WAYPOINT_FRAMES = 40


@dataclass(frozen=True)
class Figure:
    """One line of the gate. at_least: whether the bound is a least (else a most)."""

    name: str
    value: float
    bound: float
    unit: str
    at_least: bool = False

    @property
    def met(self) -> bool:
        return self.value >= self.bound if self.at_least else self.value <= self.bound


class Gate:
    """Runs the gate's checks on one model and the test split of one data set."""

    def __init__(
        self, model: Model, encoder: TextEncoder, bank: FeatureBank, num_steps: int, weights: GuidanceWeights
    ) -> None:
        self.model = model
        self.encoder = encoder
        self.bank = bank
        self.num_steps = num_steps
        self.weights = weights

    def text(self, prompt: str, count: int) -> Tensor:
        """The prompt's embedding, repeated: (count, W)."""
        return torch.from_numpy(self.encoder.encode([prompt])).expand(count, -1)

    def figures(self) -> list[Figure]:
        """All checks."""
        return [self.reconstruction(), *self.walking(), self.waypoints(), *self.waving()]

    @torch.no_grad()
    def reconstruction(self) -> Figure:
        """Joint error of encoding and decoding every test clip, up to 6 s of it."""
        layout, codec = self.model.representation, self.model.codec
        errors = []
        for clip in range(self.bank.num_clips):
            length = min(int(self.bank.length[clip]) // 4 * 4, 6 * layout.fps)
            frames = self.bank.gather(np.array([clip]), np.array([0]), length)
            frames = layout.translate_ground(frames, -frames[:, 0, [0, 2]])
            tokens = codec.to_hybrid(layout.normalize(frames))
            decoded = layout.denormalize(codec.from_hybrid(tokens, torch.tensor([length])))
            errors.append(float(joint_error(layout, decoded, frames)))
        return Figure("reconstruction, joint error on test clips", float(np.mean(errors)), 0.04, "m")

    def walking(self) -> list[Figure]:
        """A walk from nothing, 4 s, 20 seeds."""
        layout = self.model.representation
        text = self.text("a person walks forward", len(SEEDS))
        motion = generate_batch(self.model, text, SEEDS, 2, self.num_steps, weights=self.weights)
        finite = motion.isfinite().all(dim=-1).all(dim=-1)
        far = (travel(motion) >= 2.0) & finite
        return [
            Figure("walks forward 2 m or more in 4 s", float(far.sum()), 18, "of 20", at_least=True),
            Figure("NaN in walks", float((~finite).sum()), 0, "of 20"),
            Figure("feet sliding in walks", float(foot_sliding(layout, motion)), 0.5, "m/s"),
        ]

    def waypoints(self) -> Figure:
        """Test clips go on from 0.8 s of history to where their root really was 2 s later."""
        layout = self.model.representation
        clips = np.flatnonzero(self.bank.length >= HISTORY + WAYPOINT_FRAMES)
        errors = []
        for chunk in np.array_split(clips, max(1, len(clips) // 32)):
            frames = self.bank.gather(chunk, np.zeros_like(chunk), HISTORY + WAYPOINT_FRAMES)
            frames = layout.translate_ground(frames, -frames[:, HISTORY - 1, [0, 2]])
            goal = frames[:, -1, [0, 2]]
            targets = []
            for row in range(len(chunk)):
                targets.append(Targets(layout.skeleton))
                targets[-1].add_root([HISTORY + WAYPOINT_FRAMES - 1], goal[row : row + 1])
            captions = [self.bank.clips[clip].captions[0] for clip in chunk]
            text = torch.from_numpy(self.encoder.encode(captions))
            history = layout.normalize(frames[:, :HISTORY])
            seeds = [int(clip) for clip in chunk]
            motion = generate_batch(self.model, text, seeds, 1, self.num_steps, history, targets, self.weights)
            errors.append((motion[:, WAYPOINT_FRAMES - 1, [0, 2]] - goal).norm(dim=-1))
        return Figure("root waypoint 2 s ahead, mean error", float(torch.cat(errors).mean()), 0.15, "m")

    def waving(self) -> list[Figure]:
        """Waving with one hand from nothing, 4 s, 20 seeds; the mirror image is reported too."""
        layout = self.model.representation
        figures = []
        for side, other in (("right", "left"), ("left", "right")):
            text = self.text(f"a person waves with the {side} hand", len(SEEDS))
            motion = generate_batch(self.model, text, SEEDS, 2, self.num_steps, weights=self.weights)
            right = hand_raised(layout, motion, side) & ~hand_raised(layout, motion, other)
            figures.append(Figure(f"waves with the {side} hand only", float(right.sum()), 16, "of 20", at_least=True))
        return figures


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.evaluate.gate", description=__doc__)
    parser.add_argument("model", help="built-in model's name or a checkpoint folder")
    parser.add_argument("data", type=Path, help="data set made by `python -m motiongen_ardy.data build`")
    parser.add_argument("--steps", type=int, default=10, help="denoising steps (default %(default)s)")
    parser.add_argument("--text-guidance", type=float, default=1.5, help="as the server's default (%(default)s)")
    parser.add_argument("--constraint-guidance", type=float, default=2.5, help="as the server's default (%(default)s)")
    parser.add_argument("--text-encoder", default="static")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    arguments = parser.parse_args()
    model = load_checkpoint(model_folder(arguments.model))
    encoder = load_text_encoder(arguments.text_encoder, model.config.denoiser.text_dim)
    dataset = MotionDataset.load(arguments.data, "test")
    bank = build_feature_bank(dataset, natural_layout(dataset.skeleton, model.config.fps), mirror=False)
    weights = GuidanceWeights(arguments.text_guidance, arguments.constraint_guidance)
    figures = Gate(model, encoder, bank, arguments.steps, weights).figures()
    table = Table("figure", "value", "bound", "met", title=f"{arguments.model}, {arguments.steps} steps")
    for figure in figures:
        bound = f"{'>=' if figure.at_least else '<='} {figure.bound:g} {figure.unit}"
        table.add_row(figure.name, f"{figure.value:.3f}", bound, "yes" if figure.met else "NO")
    Console().print(table)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps([asdict(figure) for figure in figures], indent=1), encoding="utf-8")
    sys.exit(0 if all(figure.met for figure in figures) else 1)


if __name__ == "__main__":
    main()
