"""Random training windows: a stretch of a clip split into history, horizon and future, with text and constraints.

Windows of a batch share one of a few shapes, so that a batch costs little more than its rows need, and so that a step
can be captured once for each shape and replayed. Everything is drawn on the device of the feature bank.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.config import RELEASED_PATCH, ConfigError
from motiongen_ardy.model.rollout import usual_history
from motiongen_ardy.train.constraint_sampling import ConstraintSampler, WindowSpans
from motiongen_ardy.train.feature_bank import MIN_CLIP_FRAMES, FeatureBank

TEXT_DROP = 0.15
USUAL_FRAMES = 64  # the batch size is told in windows of this length
SHORT_HISTORY_CHANCE = 0.5
NO_HISTORY_CHANCE = 0.1
PERTURBED_CHANCE = 0.08
PERTURBED_GROUND_M = 0.03


Frames = TypeVar("Frames", int, Tensor)


@dataclass(frozen=True)
class WindowShape:
    """Longest history and future of a batch's windows, in frames, and how often batches have this shape."""

    history: int
    future: int
    chance: float


# Most batches are short because most work at run time is; the longest reach 10 s at 20 frames a second.
SHAPES = (
    WindowShape(16, 0, 0.30),
    WindowShape(16, 40, 0.20),
    WindowShape(16, 144, 0.15),
    WindowShape(40, 40, 0.15),
    WindowShape(80, 80, 0.12),
    WindowShape(160, 0, 0.08),
)


@dataclass(frozen=True)
class OwnHistory:
    """The shape of batches whose history the model makes itself: its last window before the one that is trained."""

    future: int = 40


@dataclass(frozen=True)
class EarlierWindows:
    """The windows before a batch's own, and how what the model makes of them becomes the history.

    num_tokens: of the history that is replaced. first_token: (B) int64, the token of `windows` that is the batch's
    first; used: (B) bool, false for rows whose clip does not reach back so far, which keep their true history.
    """

    windows: TrainingWindows
    num_tokens: int
    first_token: Tensor
    used: Tensor

    def as_history(self, made: Tensor, true: Tensor) -> Tensor:
        """Latents (B, N, L) of which the history is that of `made` (B, N', L), where it is to be used."""
        count = self.num_tokens
        at = self.first_token[:, None] + torch.arange(count, device=made.device)
        taken = made.gather(1, at[..., None].expand(-1, -1, made.shape[-1]))
        head = torch.where(self.used[:, None, None], taken, true[:, :count])
        return torch.cat([head, true[:, count:]], dim=1)


@dataclass(frozen=True)
class TrainingWindows:
    """A batch of windows, every tensor on the training device.

    features: (B, T, D) normalised, origin at the last history frame (the first frame where there is no history).
    history_len, generation_len, length: (B) frames, multiples of the patch; length counts the future too. num_known: no
    row's history and horizon are longer.
    observed, mask: (B, T, D), zero outside constraints. exact: (B) bool, false where the observed numbers were
    perturbed, so that they are no goals to be met.
    text: (B, 1, W); heading: (B) radians, of the first frame.
    earlier: the windows that the history is to be made from, None for histories as captured.
    """

    features: Tensor
    history_len: Tensor
    generation_len: Tensor
    length: Tensor
    num_known: int
    observed: Tensor
    mask: Tensor
    exact: Tensor
    text: Tensor
    heading: Tensor
    earlier: EarlierWindows | None = None


@dataclass(frozen=True)
class _Rows:
    """Where a batch's windows lie in their clips. All (B) int64, in frames.

    boundary: the first generated frame in the clip; left: frames of the clip from there on.
    """

    clips: Tensor
    boundary: Tensor
    left: Tensor
    history: Tensor


class WindowSampler:
    """Draws batches of windows from a feature bank."""

    def __init__(
        self,
        bank: FeatureBank,
        text_embeddings: np.ndarray,
        representation: Representation,
        horizon: int,
        batch: int,
        patch: int = RELEASED_PATCH,
    ) -> None:
        """horizon: frames that a window generates; batch: windows of 64 frames; patch: frames of a token.

        Raises ConfigError for a horizon that no window of training has room for.
        """
        self.bank = bank
        self.text_embeddings = torch.from_numpy(text_embeddings).float().to(bank.device)
        self.representation = representation
        self.constraints = ConstraintSampler(representation)
        self.horizon = horizon
        self.batch = batch
        self.patch = patch
        self.own_history = usual_history(patch)  # what servers give a window
        longest = 10 * representation.fps // patch * patch
        shapes = [self._whole(shape) for shape in SHAPES]
        self.shapes = tuple(shape for shape in shapes if shape.history + horizon + shape.future <= longest)
        if not self.shapes:
            least = min(shape.history + shape.future for shape in shapes)
            raise ConfigError(
                f"model.horizon is {horizon}; a window of training lasts 10 s at most, {longest} frames, of which"
                f" {least} at least are history: give at most {longest - least}"
            )

    def count(self, shape: WindowShape | OwnHistory) -> int:
        """Windows of a batch of one shape, so that batches of all shapes cost about the same."""
        history = shape.history if isinstance(shape, WindowShape) else self.own_history
        return max(1, round(self.batch * USUAL_FRAMES / (history + self.horizon + shape.future)))

    def sample(self, shape: WindowShape | OwnHistory, generator: torch.Generator | None = None) -> TrainingWindows:
        """A batch of one shape; everything random comes from `generator` (the device's own if None)."""
        if isinstance(shape, OwnHistory):
            return self._with_earlier(shape, generator)
        rows = self._rows(self.count(shape), generator, lambda boundary: self._history(shape, boundary, generator))
        num_frames = shape.history + self.horizon + shape.future
        frames = self._turned(rows.clips, rows.boundary - rows.history, num_frames, generator)
        return self._windows(frames, rows, shape.future, generator)

    def _with_earlier(self, shape: OwnHistory, generator: torch.Generator | None) -> TrainingWindows:
        """Windows with the history that servers give, and the windows before them, whose horizon ends with it."""
        given, future = self.own_history, self._tokens_of(shape.future)
        rows = self._rows(self.count(shape), generator, lambda boundary: self._tokens_of(boundary).clamp(max=given))
        before = (rows.boundary - self.horizon).clamp(min=0)
        earlier_history = self._tokens_of(before).clamp(max=given)
        # Where the horizon is shorter than what is given, the earlier window has to hold all of that with its history.
        used = (rows.boundary >= self.horizon) & (earlier_history + self.horizon >= given)
        earlier_history = torch.where(used, earlier_history, rows.history)
        start = torch.where(used, before, rows.boundary) - earlier_history
        span = given + 2 * self.horizon + future
        frames = self._turned(rows.clips, start, span, generator)
        offset = torch.where(used, earlier_history + self.horizon - given, 0)
        at = offset[:, None] + torch.arange(given + self.horizon + future, device=offset.device)
        own = frames.gather(1, at[..., None].expand(-1, -1, frames.shape[-1]))
        earlier = _Rows(rows.clips, start + earlier_history, rows.left + self.horizon, earlier_history)
        windows = self._windows(frames[:, : given + self.horizon], earlier, 0, generator, guided=True)
        batch = self._windows(own, rows, future, generator)
        return replace(batch, earlier=EarlierWindows(windows, given // self.patch, offset // self.patch, used))

    def _tokens_of(self, frames: Frames) -> Frames:
        """The frames of the whole tokens in so many frames."""
        return frames // self.patch * self.patch

    def _whole(self, shape: WindowShape) -> WindowShape:
        """A shape of whole tokens, with a token of history at least."""
        history = max(self.patch, self._tokens_of(shape.history))
        return replace(shape, history=history, future=self._tokens_of(shape.future))

    def _rows(self, count: int, generator: torch.Generator | None, history: Callable[[Tensor], Tensor]) -> _Rows:
        clips = self.bank.draw_clips(count, generator)
        clip_length = self.bank.length[clips]
        room = (clip_length - self.horizon).clamp(min=0)
        boundary = (self._uniform(generator, count) * (room + 1)).long()
        return _Rows(clips, boundary, clip_length - boundary, history(boundary))

    def _windows(
        self, frames: Tensor, rows: _Rows, most_future: int, generator: torch.Generator | None, guided: bool = False
    ) -> TrainingWindows:
        """Windows of frames (B, T, D) in natural units. guided: told the root's whole way, so that they stay on it."""
        device, history = self.bank.device, rows.history
        whole = torch.minimum(self._tokens_of(rows.left), torch.full_like(rows.left, self.horizon))
        whole = whole.clamp(min=min(self._tokens_of(MIN_CLIP_FRAMES), self.horizon))
        caption, generation = self.bank.captions.draw(
            self.bank.first[rows.clips] + rows.boundary, whole, rows.left, self.patch, generator
        )
        generation = whole if guided else generation
        beyond = self._tokens_of((rows.left - generation).clamp(min=0))
        future = beyond if most_future else torch.zeros_like(beyond)
        length = (history + generation + future).clamp(max=frames.shape[1])
        count = len(history)
        index = torch.arange(count, device=device)
        origin = frames[index, (history - 1).clamp(min=0)][:, 0:3:2]
        frames = self.representation.translate_ground(frames, -origin)
        if guided:
            mask = self._guide(frames, history, length)
        else:
            planted = frames[..., self.representation.contact_block][..., 0::2] > 0.5
            mask = self.constraints.sample(WindowSpans(history, history + generation, length, planted), generator)
        mask = mask.float()
        features = self.representation.normalize(frames)
        told = self._uniform(generator, count) >= TEXT_DROP
        exact = self._uniform(generator, count) >= PERTURBED_CHANCE
        wrong = torch.randn(count, 1, 2, generator=generator, device=device) * PERTURBED_GROUND_M
        seen = self.representation.normalize(_moved(frames, wrong * ~exact[:, None, None]))
        return TrainingWindows(
            features=features,
            history_len=history,
            generation_len=generation,
            length=length,
            num_known=frames.shape[1] - most_future,
            observed=seen * mask,
            mask=mask,
            exact=exact,
            text=(self.text_embeddings[caption] * told[:, None])[:, None],
            heading=torch.atan2(frames[:, 0, 4], frames[:, 0, 3]),
        )

    def _guide(self, frames: Tensor, history: Tensor, length: Tensor) -> Tensor:
        """Masks (B, T, D) of ground position and heading at the last frame of every token after the history."""
        at = torch.arange(frames.shape[1], device=frames.device)
        on = (at >= history[:, None]) & (at < length[:, None]) & ((at % self.patch) == self.patch - 1)
        columns = torch.arange(frames.shape[2], device=frames.device)
        root = ((columns < 5) & (columns != 1))[None, None]
        return on[..., None] & root

    def _uniform(self, generator: torch.Generator | None, count: int) -> Tensor:
        return torch.rand(count, generator=generator, device=self.bank.device)

    def _history(self, shape: WindowShape, boundary: Tensor, generator: torch.Generator | None) -> Tensor:
        """History lengths (B), whole tokens, as far as the clips reach back."""
        count = len(boundary)
        wanted = (self._uniform(generator, count) * (shape.history // self.patch + 1)).long() * self.patch
        # A long history is useful only if most rows have it, so half of the rows take the longest they can.
        wanted = torch.where(self._uniform(generator, count) < SHORT_HISTORY_CHANCE, wanted, shape.history)
        wanted = torch.where(self._uniform(generator, count) < NO_HISTORY_CHANCE, 0, wanted)
        return torch.minimum(wanted, self._tokens_of(boundary))

    def _turned(self, clips: Tensor, starts: Tensor, num_frames: int, generator: torch.Generator | None) -> Tensor:
        """Frames (B, T, D) of clips in natural units, turned at random."""
        frames = self.bank.gather(clips, starts, num_frames)
        angle = (self._uniform(generator, len(clips)) * 2 - 1) * torch.pi
        return self.representation.rotate(frames, angle, orthonormal=True)


def _moved(frames: Tensor, offset: Tensor) -> Tensor:
    """Frames (B, T, D) whose roots are moved over the ground by (B, 1, 2) metres."""
    ground = frames[..., 0:3:2] + offset
    return torch.cat([ground[..., :1], frames[..., 1:2], ground[..., 1:], frames[..., 3:]], dim=-1)
