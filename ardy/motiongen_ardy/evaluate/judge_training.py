"""Train the text judge: `python -m motiongen_ardy.evaluate.judge_training DATA FOLDER`, a few minutes on one core."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.evaluate.judge import MAX_FRAMES, TextJudge, frame_dim, judge_frames, save_judge
from motiongen_ardy.text import TextEncoder, load_text_encoder
from motiongen_ardy.train.feature_bank import FeatureBank, build_feature_bank, natural_layout

MIN_FRAMES = 40


@dataclass(frozen=True)
class JudgeBatch:
    """frames: (B, T, F); lengths: (B); texts: (B, W); labels: (B), equal where content and style are."""

    frames: Tensor
    lengths: Tensor
    texts: Tensor
    labels: Tensor


class JudgeBatches:
    """Random windows of a feature bank with a caption that may be said of them."""

    def __init__(self, bank: FeatureBank, layout: Representation, encoder: TextEncoder, seed: int) -> None:
        self._bank, self._layout = bank, layout
        self._texts = torch.from_numpy(encoder.encode(bank.texts))
        names = [(caption_set(clip.content, clip.style)) for clip in bank.clips]
        known = {name: number for number, name in enumerate(sorted(set(names)))}
        self._labels = np.array([known[name] for name in names])
        self._random = np.random.default_rng(seed)

    def draw(self, size: int) -> JudgeBatch:
        bank, random = self._bank, self._random
        clips = random.choice(bank.num_clips, size, p=bank.weight)
        rows, texts = [], []
        for clip in clips:
            length = min(int(bank.length[clip]), int(random.integers(MIN_FRAMES, MAX_FRAMES + 1)))
            start = int(random.integers(bank.length[clip] - length + 1))
            first = int(bank.first[clip]) + start
            rows.append(judge_frames(self._layout, bank.features[first : first + length]))
            texts.append(bank.draw_caption(random, int(clip), start, length))
        lengths = torch.tensor([len(row) for row in rows])
        padded = nn.utils.rnn.pad_sequence(rows, batch_first=True)
        return JudgeBatch(padded, lengths, self._texts[texts], torch.from_numpy(self._labels[clips]))


def caption_set(content: str, style: str) -> str:
    """What tells captions apart: clips with the same are described by the same words."""
    return f"{content}/{style}"


def contrastive_loss(judge: TextJudge, batch: JudgeBatch) -> Tensor:
    """InfoNCE both ways; rows with the same content and style are no negatives of each other."""
    scores = judge.motions(batch.frames, batch.lengths) @ judge.texts(batch.texts).T * judge.log_scale.exp()
    same = batch.labels[:, None] == batch.labels[None]
    own = torch.eye(len(same), dtype=torch.bool)
    scores = scores.masked_fill(same & ~own, -torch.inf)
    target = torch.arange(len(same))
    return (functional.cross_entropy(scores, target) + functional.cross_entropy(scores.T, target)) / 2


def train_judge(dataset: MotionDataset, encoder: TextEncoder, fps: int, steps: int, seed: int = 0) -> TextJudge:
    """A judge trained on all clips of a set and their mirror images."""
    torch.manual_seed(seed)
    layout = natural_layout(dataset.skeleton, fps)
    bank = build_feature_bank(dataset, layout)
    batches = JudgeBatches(bank, layout, encoder, seed)
    judge = TextJudge(frame_dim(layout), encoder.width)
    sample = batches.draw(512)
    valid = torch.cat([row[:length] for row, length in zip(sample.frames, sample.lengths, strict=True)])
    judge.mean.copy_(valid.mean(dim=0))
    judge.std.copy_(valid.std(dim=0).clamp(min=0.02))
    optimizer = torch.optim.AdamW(judge.parameters(), lr=1e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, total_steps=steps)
    began = time.monotonic()
    for step in range(1, steps + 1):
        batch = batches.draw(96)
        loss = contrastive_loss(judge, batch)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(judge.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        if step % 100 == 0:
            print(f"step {step}: loss {float(loss.detach()):.3f}, {time.monotonic() - began:.0f} s", flush=True)
    return judge.eval()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.evaluate.judge_training", description=__doc__)
    parser.add_argument(
        "data", type=Path, help="data set made by `python -m motiongen_ardy.data build`; its train split is used"
    )
    parser.add_argument("folder", type=Path, help="where the weights go")
    parser.add_argument("--steps", type=int, default=1500, help="default %(default)s")
    parser.add_argument("--text-encoder", default="static")
    parser.add_argument("--text-width", type=int, default=256, help="of an encoder without one of its own")
    arguments = parser.parse_args()
    dataset = MotionDataset.load(arguments.data, "train")
    encoder = load_text_encoder(arguments.text_encoder, arguments.text_width)
    save_judge(train_judge(dataset, encoder, round(dataset.fps), arguments.steps), arguments.folder)


if __name__ == "__main__":
    main()
