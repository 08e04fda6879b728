"""Train the text judge: `python -m motiongen_ardy.evaluate.judge_training DATA FOLDER`, a few minutes on one core."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.core.output import command
from motiongen_ardy.core.representation import Representation
from motiongen_ardy.data.dataset import Clip, DatasetError, MotionDataset
from motiongen_ardy.evaluate.judge import MAX_FRAMES, TextJudge, frame_dim, judge_frames, save_judge
from motiongen_ardy.text import TextEncoder, TextWidthMismatch, UnknownTextEncoder, load_text_encoder
from motiongen_ardy.train.feature_bank import FeatureBank, build_feature_bank, natural_layout

MIN_FRAMES = 40


@dataclass(frozen=True)
class JudgeBatch:
    """frames: (B, T, F); lengths: (B); texts: (B, W); labels: (B), equal for equal content and style."""

    frames: Tensor
    lengths: Tensor
    texts: Tensor
    labels: Tensor


class JudgeBatches:
    """Random windows of a feature bank, each with a caption that applies to it."""

    def __init__(self, bank: FeatureBank, layout: Representation, encoder: TextEncoder, seed: int) -> None:
        self._bank, self._layout = bank, layout
        self._texts = torch.from_numpy(encoder.encode(bank.captions.texts))
        self._number = {text: number for number, text in enumerate(bank.captions.texts)}
        names = [(caption_set(clip.content, clip.style)) for clip in bank.clips]
        known = {name: number for number, name in enumerate(sorted(set(names)))}
        self._labels = np.array([known[name] for name in names])
        self._random = np.random.default_rng(seed)

    def draw(self, size: int) -> JudgeBatch:
        bank, random = self._bank, self._random
        clips = random.choice(bank.num_clips, size, p=bank.weight.numpy())
        rows, texts = [], []
        for clip in clips:
            whole = int(bank.length[clip])
            length = min(whole, int(random.integers(MIN_FRAMES, MAX_FRAMES + 1)))
            start = int(random.integers(whole - length + 1))
            first = int(bank.first[clip]) + start
            rows.append(judge_frames(self._layout, bank.features[first : first + length]))
            captions = captions_of(bank.clips[clip], start, length)
            texts.append(self._number[captions[int(random.integers(len(captions)))]])
        lengths = torch.tensor([len(row) for row in rows])
        padded = nn.utils.rnn.pad_sequence(rows, batch_first=True)
        return JudgeBatch(padded, lengths, self._texts[texts], torch.from_numpy(self._labels[clips]))


def captions_of(clip: Clip, start: int, length: int) -> tuple[str, ...]:
    """The captions that apply to frames start .. start + length - 1: a segment's, if it contains them all."""
    for segment in clip.segments:
        if segment.start <= start and start + length <= segment.start + segment.length:
            return segment.captions
    return clip.captions


def caption_set(content: str, style: str) -> str:
    """The key that distinguishes captions: clips with the same key are described by the same words."""
    return f"{content}/{style}"


def contrastive_loss(judge: TextJudge, batch: JudgeBatch) -> Tensor:
    """InfoNCE in both directions; rows with the same content and style are not negatives of each other."""
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
    judge = TextJudge(frame_dim(layout), encoder.width, fps, encoder.identity)
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


def main(given: Sequence[str] | None = None) -> int:
    """Command line. Returns 2 for input that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.evaluate.judge_training", description=__doc__)
    parser.add_argument(
        "data", type=Path, help="data set made by `python -m motiongen_ardy.data build`; its train split is used"
    )
    parser.add_argument("folder", type=Path, help="where the weights go")
    parser.add_argument("--steps", type=int, default=1500, help="default %(default)s")
    parser.add_argument("--text-encoder", default="static")
    parser.add_argument("--text-width", type=int, default=256, help="for an encoder without a width of its own")
    arguments = parser.parse_args(given)
    try:
        dataset = MotionDataset.load(arguments.data, "train")
        fps = round(dataset.fps)
        dataset.require(dataset.skeleton.name, fps)  # a model's frame rate is a whole number
        width = arguments.text_width if arguments.text_encoder == "hashed" else None
        encoder = load_text_encoder(arguments.text_encoder, width)
        arguments.folder.mkdir(parents=True, exist_ok=True)
        save_judge(train_judge(dataset, encoder, fps, arguments.steps), arguments.folder)
    except (DatasetError, UnknownTextEncoder, TextWidthMismatch, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(command(main))
