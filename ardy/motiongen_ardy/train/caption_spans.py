"""The captions that apply to each frame of the training set, as tables on a device.

Clips have captions of their own, and segments with narrower ones. Every frame belongs to one set of captions; a window
gets the caption of the frames that it generates, as a server would give it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.data.dataset import Clip

# A prompt that starts this soon after a window's first new frame counts from that frame on.
SOON_FRAMES = 10
MIN_GENERATED = 12


@dataclass(frozen=True)
class CaptionSpans:
    """Which set of captions each frame belongs to.

    frame_set: (F) int64, the caption set of each frame. until_next: (F) int64, frames until the set changes or the
    clip ends. sets: (S, K) int64, indices of texts, rows padded by repetition; set_size: (S) int64.
    texts: every caption, in the order of the embeddings to be looked up.
    """

    frame_set: Tensor
    until_next: Tensor
    sets: Tensor
    set_size: Tensor
    texts: tuple[str, ...]

    def draw(
        self, frames: Tensor, generation: Tensor, left: Tensor, patch: int, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        """A caption (B) for windows whose first new frame is `frames` (B), and for how many frames (B) it applies.

        generation: (B), frames that the window would generate; left: (B), frames of the clip from there on; patch:
        frames per token. If another caption begins soon, the window gets that one; if it begins later, the window is
        cut before it, as a server replans when a prompt changes.
        """
        until = self.until_next[frames]
        soon = (until <= SOON_FRAMES) & (until < left)
        said = torch.where(soon, frames + until, frames)
        holds = torch.where(soon, until + self.until_next[said], until)
        least = -(-MIN_GENERATED // patch) * patch
        cut = (torch.minimum(holds, generation) // patch * patch).clamp(min=least)
        chosen = self.frame_set[said]
        share = torch.rand(len(frames), generator=generator, device=frames.device)
        which = (share * self.set_size[chosen]).long().clamp(max=self.sets.shape[1] - 1)
        return self.sets[chosen, which], torch.minimum(cut, generation)


def caption_spans(clips: Sequence[Clip], device: torch.device | str = "cpu") -> CaptionSpans:
    """The caption sets of concatenated clips."""
    texts: dict[str, int] = {}
    sets: dict[tuple[str, ...], int] = {}
    frame_set, until_next = [], []
    for clip in clips:
        row = np.full(clip.num_frames, sets.setdefault(clip.captions, len(sets)))
        for segment in clip.segments:
            row[segment.start : segment.start + segment.length] = sets.setdefault(segment.captions, len(sets))
        frame_set.append(row)
        changes = np.append(np.flatnonzero(np.diff(row)) + 1, clip.num_frames)
        at = np.arange(clip.num_frames)
        until_next.append(changes[np.searchsorted(changes, at, side="right")] - at)
    for captions in sets:
        for caption in captions:
            texts.setdefault(caption, len(texts))
    width = max(len(captions) for captions in sets)
    table = [[texts[captions[index % len(captions)]] for index in range(width)] for captions in sets]
    return CaptionSpans(
        frame_set=torch.from_numpy(np.concatenate(frame_set)).to(device),
        until_next=torch.from_numpy(np.concatenate(until_next)).to(device),
        sets=torch.tensor(table, device=device),
        set_size=torch.tensor([len(captions) for captions in sets], device=device),
        texts=tuple(texts),
    )
