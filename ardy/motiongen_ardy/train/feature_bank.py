"""All clips of a training set as feature frames on one device, plus their mirror images where allowed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH, ROOT_WIDTH, Representation
from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.data.dataset import Clip, DatasetError, MotionDataset
from motiongen_ardy.train.caption_spans import CaptionSpans, caption_spans

MIN_CLIP_FRAMES = 16
CLIPS_AT_ONCE = 64


@dataclass(frozen=True)
class FeatureBank:
    """Concatenated clips, every tensor on one device.

    features: (F, D) float32 in natural units, in the world frame of each clip.
    first, length: (C) int64, where each clip is; weight: (C) float64, the chance of drawing it; the sum is 1.
    clips: the clips themselves, in the same order. captions: the captions that apply to each frame.
    """

    features: Tensor
    first: Tensor
    length: Tensor
    weight: Tensor
    clips: tuple[Clip, ...]
    captions: CaptionSpans

    @property
    def num_clips(self) -> int:
        return len(self.clips)

    @property
    def device(self) -> torch.device:
        return self.features.device

    def draw_clips(self, count: int, generator: torch.Generator | None = None) -> Tensor:
        """(count) int64, clips drawn by weight."""
        share = torch.rand(count, generator=generator, device=self.device, dtype=torch.float64)
        return torch.searchsorted(self.weight.cumsum(0), share, right=True).clamp(max=len(self.weight) - 1)

    def gather(self, clips: Tensor, starts: Tensor, num_frames: int) -> Tensor:
        """Frames starts..starts+num_frames-1 of clips (B) -> (B, num_frames, D); a clip's last frame is repeated."""
        within = starts[:, None] + torch.arange(num_frames, device=self.device)
        within = torch.minimum(within, self.length[clips][:, None] - 1)
        return self.features[self.first[clips][:, None] + within]


def natural_layout(skeleton: Skeleton, fps: int) -> Representation:
    """A representation with mean 0 and std 1, for working in natural units."""
    width = skeleton.feature_dim + LOCAL_ROOT_WIDTH
    return Representation(skeleton, fps, Stats(torch.zeros(width), torch.ones(width)))


def build_feature_bank(
    dataset: MotionDataset, layout: Representation, mirror: bool = True, device: torch.device | str = "cpu"
) -> FeatureBank:
    """Features of every clip of at least `MIN_CLIP_FRAMES` frames, and of its mirror image.

    A clip's weight is its length divided by the square root of its content's total length, so that rare contents are
    seen but not overused. layout: a representation with the data's skeleton; its statistics are not used. Raises
    DatasetError if no clip is long enough.
    """
    clips = [clip for clip in dataset.clips if clip.num_frames >= MIN_CLIP_FRAMES]
    if not clips:
        raise DatasetError(
            f"none of the {len(dataset.clips)} clips to train on has {MIN_CLIP_FRAMES} frames; record longer ones"
        )
    if mirror:
        clips += [clip.mirrored(dataset.skeleton) for clip in clips if clip.mirror_allowed]
    length = np.array([clip.num_frames for clip in clips])
    return FeatureBank(
        features=_features(clips, layout.to(device), torch.device(device)),
        first=torch.from_numpy(np.concatenate([[0], np.cumsum(length)[:-1]])).to(device),
        length=torch.from_numpy(length).to(device),
        weight=torch.from_numpy(_weights(clips)).to(device),
        clips=tuple(clips),
        captions=caption_spans(clips, device),
    )


def _features(clips: Sequence[Clip], layout: Representation, device: torch.device) -> Tensor:
    """Features (F, D) of concatenated clips; clips of similar length are computed together."""
    order = sorted(range(len(clips)), key=lambda number: clips[number].num_frames)
    blocks: list[Tensor] = [torch.empty(0)] * len(clips)
    for start in range(0, len(order), CLIPS_AT_ONCE):
        numbers = order[start : start + CLIPS_AT_ONCE]
        rotations = pad_sequence([clips[number].local_rotations for number in numbers], batch_first=True).to(device)
        roots = pad_sequence([clips[number].root_positions for number in numbers], batch_first=True).to(device)
        lengths = torch.tensor([clips[number].num_frames for number in numbers], device=device)
        beyond = torch.arange(rotations.shape[1], device=device) >= lengths[:, None]
        rotations[beyond] = torch.nn.functional.one_hot(torch.tensor(0, device=device), 4).float()  # identity
        features = layout.features(quaternion_to_matrix(rotations), roots, lengths)
        for row, number in enumerate(numbers):
            blocks[number] = features[row, : clips[number].num_frames].clone()
    return torch.cat(blocks)


def _weights(clips: Sequence[Clip]) -> np.ndarray:
    totals: dict[str, int] = {}
    for clip in clips:
        totals[clip.content] = totals.get(clip.content, 0) + clip.num_frames
    weight = np.array([clip.num_frames / np.sqrt(totals[clip.content]) for clip in clips])
    normalised: np.ndarray = weight / weight.sum()
    return normalised


def measure_stats(bank: FeatureBank, layout: Representation, num_windows: int = 4096, seed: int = 0) -> Stats:
    """Statistics of width D + 4 (root, local root, body) over random windows, turned at random about +Y.

    The windows span history, horizon and future, with the origin at their last history frame, so that the root's spread
    is what the denoiser will see.
    """
    generator = torch.Generator(bank.device).manual_seed(seed)
    layout = layout.to(bank.device)
    num_frames, origin, device = 80, 20, bank.device
    clips = bank.draw_clips(num_windows, generator)
    room = (bank.length[clips] - num_frames).clamp(min=1)
    starts = (torch.rand(num_windows, generator=generator, device=device) * room).long()
    frames = bank.gather(clips, starts, num_frames)
    angle = (torch.rand(num_windows, generator=generator, device=device) * 2 - 1) * torch.pi
    frames = layout.rotate(frames, angle, orthonormal=True)
    frames = layout.translate_ground(frames, -frames[:, origin, 0:3:2])
    valid = starts[:, None] + torch.arange(num_frames, device=device) < bank.length[clips][:, None]
    # The identity statistics (mean 0, std 1) leave the local root in natural units up to the variance floor.
    lengths = valid.sum(1)
    local = layout.local_root_stats.denormalize(
        layout.local_root(layout.root_stats.normalize(frames[..., :ROOT_WIDTH]), lengths)
    )
    rows = torch.cat([frames[..., :ROOT_WIDTH], local, frames[..., ROOT_WIDTH:]], dim=-1)[valid].double()
    return Stats(rows.mean(0).float(), rows.std(0).float())
