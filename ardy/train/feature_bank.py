"""All clips of a training set as feature frames in memory, each also mirrored where that is allowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ardy.data.dataset import Clip, MotionDataset
from ardy.data.mirror import mirror_clip
from ardy.representation import Representation
from ardy.rotation import quaternion_to_matrix
from ardy.stats import Stats

MIN_CLIP_FRAMES = 16


@dataclass(frozen=True)
class FeatureBank:
    """Clips one after another.

    features: (F, D) float32 in natural units, world frame of each clip.
    first, length: (C) int64, where each clip lies; weight: (C) float64, chance of drawing it.
    captions: for each clip the indices of its captions in `texts`.
    """

    features: Tensor
    first: np.ndarray
    length: np.ndarray
    weight: np.ndarray
    captions: list[list[int]]
    texts: list[str]

    @property
    def num_clips(self) -> int:
        return len(self.length)

    def gather(self, clips: np.ndarray, starts: np.ndarray, num_frames: int) -> Tensor:
        """Frames starts..starts+num_frames-1 of clips (B) -> (B, num_frames, D); past a clip's end its last frame."""
        within = np.minimum(starts[:, None] + np.arange(num_frames), self.length[clips][:, None] - 1)
        return self.features[torch.from_numpy(self.first[clips][:, None] + within)]


def build_feature_bank(dataset: MotionDataset, fps: int, mirror: bool = True) -> FeatureBank:
    """Features of every clip of at least `MIN_CLIP_FRAMES` frames, and of its mirror image.

    Clips are drawn in proportion to their length over the square root of their content's total length, so that rare
    contents are seen without being worn out.
    """
    skeleton = dataset.skeleton
    layout = Representation(skeleton, fps, Stats(torch.zeros(skeleton.feature_dim + 4), torch.ones(skeleton.feature_dim + 4)))
    blocks: list[Tensor] = []
    contents: list[str] = []
    captions: list[list[int]] = []
    text_index: dict[str, int] = {}

    def add(rotations: np.ndarray, root: np.ndarray, clip: Clip, texts: tuple[str, ...]) -> None:
        local = quaternion_to_matrix(torch.from_numpy(rotations))
        blocks.append(layout.features(local[None], torch.from_numpy(root)[None])[0])
        contents.append(clip.content)
        captions.append([text_index.setdefault(text, len(text_index)) for text in texts])

    for clip in dataset.clips:
        if clip.num_frames < MIN_CLIP_FRAMES:
            continue
        add(clip.rotations, clip.root_positions, clip, clip.captions)
        if mirror and clip.mirrored_captions:
            rotations, root = mirror_clip(skeleton, clip.rotations, clip.root_positions)
            add(rotations, root, clip, clip.mirrored_captions)

    length = np.array([len(block) for block in blocks])
    totals: dict[str, int] = {}
    for content, frames in zip(contents, length, strict=True):
        totals[content] = totals.get(content, 0) + int(frames)
    weight = length / np.sqrt([totals[content] for content in contents])
    return FeatureBank(
        features=torch.cat(blocks),
        first=np.concatenate([[0], np.cumsum(length)[:-1]]),
        length=length,
        weight=weight / weight.sum(),
        captions=captions,
        texts=list(text_index),
    )


def measure_stats(bank: FeatureBank, skeleton_stats: Representation, num_windows: int = 4096, seed: int = 0) -> Stats:
    """Statistics of width D + 4 (root, local root, body) over random windows, turned at random about +Y.

    The windows span history, horizon and future with the origin at their last history frame, so that the root's
    spread is what the denoiser will see.
    """
    generator = np.random.default_rng(seed)
    num_frames, origin = 80, 20
    clips = generator.choice(bank.num_clips, size=num_windows, p=bank.weight)
    starts = (generator.random(num_windows) * np.maximum(1, bank.length[clips] - num_frames)).astype(np.int64)
    frames = bank.gather(clips, starts, num_frames)
    angle = torch.from_numpy(generator.uniform(-np.pi, np.pi, num_windows)).float()
    frames = skeleton_stats.rotate(frames, angle, orthonormal=True)
    frames = skeleton_stats.translate_ground(frames, -frames[:, origin, [0, 2]])
    valid = torch.from_numpy(starts[:, None] + np.arange(num_frames) < bank.length[clips][:, None])
    # The identity statistics (mean 0, std 1) leave the local root in natural units up to the variance floor.
    lengths = valid.sum(1)
    local = skeleton_stats.local_root_stats.denormalize(
        skeleton_stats.local_root(skeleton_stats.root_stats.normalize(frames[..., :5]), lengths)
    )
    rows = torch.cat([frames[..., :5], local, frames[..., 5:]], dim=-1)[valid].double()
    return Stats(rows.mean(0).float(), rows.std(0).float())


