"""All clips of a training set as feature frames in memory, each also mirrored where that is allowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.data.dataset import Clip, MotionDataset
from motiongen_ardy.representation import LOCAL_ROOT_WIDTH, ROOT_WIDTH, Representation
from motiongen_ardy.rotation import quaternion_to_matrix
from motiongen_ardy.skeleton import Skeleton
from motiongen_ardy.stats import Stats

MIN_CLIP_FRAMES = 16


@dataclass(frozen=True)
class FeatureBank:
    """Clips one after another.

    features: (F, D) float32 in natural units, world frame of each clip.
    first, length: (C) int64, where each clip lies; weight: (C) float64, chance of drawing it.
    clips: the clips themselves, in the same order; text_index: every caption's place in a table of embeddings.
    """

    features: Tensor
    first: np.ndarray
    length: np.ndarray
    weight: np.ndarray
    clips: tuple[Clip, ...]
    text_index: dict[str, int]

    @property
    def num_clips(self) -> int:
        return len(self.length)

    @property
    def texts(self) -> list[str]:
        return list(self.text_index)

    def draw_caption(self, random: np.random.Generator, clip: int, start: int, length: int) -> int:
        """The index of a caption that may be said of frames start..start+length-1 of a clip, drawn at random."""
        captions = self.clips[clip].captions_for(start, length)
        return self.text_index[captions[int(random.integers(len(captions)))]]

    def gather(self, clips: np.ndarray, starts: np.ndarray, num_frames: int) -> Tensor:
        """Frames starts..starts+num_frames-1 of clips (B) -> (B, num_frames, D); past a clip's end its last frame."""
        within = np.minimum(starts[:, None] + np.arange(num_frames), self.length[clips][:, None] - 1)
        return self.features[torch.from_numpy(self.first[clips][:, None] + within)]


def natural_layout(skeleton: Skeleton, fps: int) -> Representation:
    """A representation whose statistics are mean 0 and std 1, for work in natural units."""
    width = skeleton.feature_dim + LOCAL_ROOT_WIDTH
    return Representation(skeleton, fps, Stats(torch.zeros(width), torch.ones(width)))


def build_feature_bank(dataset: MotionDataset, layout: Representation, mirror: bool = True) -> FeatureBank:
    """Features of every clip of at least `MIN_CLIP_FRAMES` frames, and of its mirror image.

    Clips are drawn in proportion to their length over the square root of their content's total length, so that rare
    contents are seen without being worn out. layout: a representation of the data's skeleton; statistics are not used.
    """
    clips = [clip for clip in dataset.clips if clip.num_frames >= MIN_CLIP_FRAMES]
    if mirror:
        clips += [clip.mirrored(dataset.skeleton) for clip in clips if clip.mirror_allowed]
    blocks = []
    for clip in clips:
        local = quaternion_to_matrix(clip.local_rotations)
        blocks.append(layout.features(local[None], clip.root_positions[None])[0])
    length = np.array([clip.num_frames for clip in clips])
    totals: dict[str, int] = {}
    text_index: dict[str, int] = {}
    for clip in clips:
        totals[clip.content] = totals.get(clip.content, 0) + clip.num_frames
        for captions in (clip.captions, *(segment.captions for segment in clip.segments)):
            for caption in captions:
                text_index.setdefault(caption, len(text_index))
    weight = length / np.sqrt([totals[clip.content] for clip in clips])
    return FeatureBank(
        features=torch.cat(blocks),
        first=np.concatenate([[0], np.cumsum(length)[:-1]]),
        length=length,
        weight=weight / weight.sum(),
        clips=tuple(clips),
        text_index=text_index,
    )


def measure_stats(bank: FeatureBank, layout: Representation, num_windows: int = 4096, seed: int = 0) -> Stats:
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
    frames = layout.rotate(frames, angle, orthonormal=True)
    frames = layout.translate_ground(frames, -frames[:, origin, [0, 2]])
    valid = torch.from_numpy(starts[:, None] + np.arange(num_frames) < bank.length[clips][:, None])
    # The identity statistics (mean 0, std 1) leave the local root in natural units up to the variance floor.
    lengths = valid.sum(1)
    local = layout.local_root_stats.denormalize(
        layout.local_root(layout.root_stats.normalize(frames[..., :ROOT_WIDTH]), lengths)
    )
    rows = torch.cat([frames[..., :ROOT_WIDTH], local, frames[..., ROOT_WIDTH:]], dim=-1)[valid].double()
    return Stats(rows.mean(0).float(), rows.std(0).float())
