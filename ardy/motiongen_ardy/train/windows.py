"""Random training windows: a stretch of a clip split into history, horizon and future, with text and constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.representation import Representation
from motiongen_ardy.train.constraint_sampling import ConstraintSampler
from motiongen_ardy.train.feature_bank import MIN_CLIP_FRAMES, FeatureBank

# Longest history and future of a batch, in frames. Most batches are short because most work at run time is, and
# because a batch costs what its longest row costs; the longest reach 10 s.
HISTORY_FRAMES = (0, 4, 8, 16, 40, 80)
HISTORY_CHANCES = (0.1, 0.15, 0.2, 0.3, 0.15, 0.1)
FUTURE_FRAMES = (0, 20, 40, 80, 120)
FUTURE_CHANCES = (0.45, 0.2, 0.15, 0.1, 0.1)
NO_HISTORY_CHANCE = 0.1
TEXT_DROP = 0.1
CONSTRAINT_DROP = 0.1


@dataclass(frozen=True)
class TrainingWindows:
    """A batch of windows, every tensor on the training device.

    features: (B, T, D) normalised, origin at the last history frame (the first frame where there is no history).
    history_len, generation_len, length: (B) frames, multiples of 4; length counts the future too.
    observed, mask: (B, T, D), zero outside constraints.
    text: (B, 1, W); heading: (B) radians, of the first frame.
    """

    features: Tensor
    history_len: Tensor
    generation_len: Tensor
    length: Tensor
    observed: Tensor
    mask: Tensor
    text: Tensor
    heading: Tensor


class WindowSampler:
    """Draws batches of windows from a feature bank."""

    def __init__(
        self,
        bank: FeatureBank,
        text_embeddings: np.ndarray,
        representation: Representation,
        horizon: int,
        batch: int,
        seconds: int = 10,
    ) -> None:
        self.bank = bank
        self.text_embeddings = torch.from_numpy(text_embeddings).float()
        self.representation = representation
        self.constraints = ConstraintSampler(representation)
        self.horizon = horizon
        self.batch = batch
        self.max_frames = seconds * representation.fps // 4 * 4

    def sample(self, generator: torch.Generator) -> TrainingWindows:
        """A batch; everything random comes from `generator`."""
        random = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        clips = random.choice(self.bank.num_clips, size=self.batch, p=self.bank.weight)
        history, starts, generation, length = self._spans(random, self.bank.length[clips])
        num_frames = int(length.max())
        frames = self.bank.gather(clips, starts, num_frames)
        angle = torch.from_numpy(random.uniform(-np.pi, np.pi, self.batch)).float()
        frames = self.representation.rotate(frames, angle, orthonormal=True)
        origin = torch.from_numpy(np.maximum(history - 1, 0))
        frames = self.representation.translate_ground(frames, -frames[torch.arange(self.batch), origin][:, [0, 2]])
        mask = torch.from_numpy(self._masks(random, frames, history, generation, length))
        heading = torch.atan2(frames[:, 0, 4], frames[:, 0, 3])
        text = self._texts(random, clips, starts + history, generation)
        device = self.representation.stats.mean.device
        features = self.representation.normalize(frames.to(device))
        mask = mask.to(device, torch.float32)
        return TrainingWindows(
            features=features,
            history_len=torch.from_numpy(history).to(device),
            generation_len=torch.from_numpy(generation).to(device),
            length=torch.from_numpy(length).to(device),
            observed=features * mask,
            mask=mask,
            text=text.to(device),
            heading=heading.to(device),
        )

    def _spans(
        self, random: np.random.Generator, clip_length: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """History length, first frame in the clip, generated length and whole length (B) of each window."""
        most_history = int(random.choice(HISTORY_FRAMES, p=HISTORY_CHANCES))
        most_future = int(random.choice(FUTURE_FRAMES, p=FUTURE_CHANCES))
        most_future = min(most_future, self.max_frames - self.horizon - most_history)
        room = np.maximum(clip_length - self.horizon, 0)
        boundary = (random.random(self.batch) * (room + 1)).astype(np.int64)  # the first generated frame
        wanted = random.integers(0, most_history // 4 + 1, self.batch) * 4
        # A long history is useful only if most rows have it, so half of the rows take the longest they can.
        wanted = np.where(random.random(self.batch) < 0.5, most_history, wanted)
        wanted = np.where(random.random(self.batch) < NO_HISTORY_CHANCE, 0, wanted)
        history = np.minimum(wanted, boundary // 4 * 4)
        generation = np.minimum(self.horizon, (clip_length - boundary) // 4 * 4)
        generation = np.maximum(generation, MIN_CLIP_FRAMES)
        left = np.maximum(clip_length - boundary - generation, 0) // 4 * 4
        future = np.minimum(left, most_future)
        return history, boundary - history, generation, history + generation + future

    def _masks(
        self,
        random: np.random.Generator,
        frames: Tensor,
        history: np.ndarray,
        generation: np.ndarray,
        length: np.ndarray,
    ) -> np.ndarray:
        contacts = frames[..., self.representation.contact_block].numpy() > 0.5
        planted = contacts[..., [0, 2]]
        masks = np.zeros(frames.shape, dtype=bool)
        for row in np.flatnonzero(random.random(self.batch) >= CONSTRAINT_DROP):
            first, end = int(history[row]), int(length[row])
            masks[row, :end] = self.constraints.sample(random, first, first + int(generation[row]), end, planted[row])
        return masks

    def _texts(self, random: np.random.Generator, clips: np.ndarray, starts: np.ndarray, lengths: np.ndarray) -> Tensor:
        """Text embeddings (B, 1, W) of captions that fit the generated frames; zero where the text is dropped."""
        chosen = [self.bank.draw_caption(random, *span) for span in zip(clips, starts, lengths, strict=True)]
        keep = torch.from_numpy(random.random(self.batch) >= TEXT_DROP).float()
        return (self.text_embeddings[torch.tensor(chosen)] * keep[:, None])[:, None]
