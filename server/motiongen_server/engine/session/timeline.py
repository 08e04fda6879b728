"""Timeline: the frames that a session holds, as rows for the wire, and as features and tokens for histories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.types import Float32Array, ModelFacts


@dataclass(frozen=True, slots=True, eq=False)
class TokenRun:
    """The tokens of consecutive frames, `patch` frames each, from frame `first` on. tokens: (M, W) float32."""

    first: int
    tokens: Float32Array
    patch: int

    @property
    def end(self) -> int:
        return self.first + len(self.tokens) * self.patch

    def spliced(self, frame: int, tokens: Float32Array | None, num_frames: int) -> TokenRun:
        """Keep the tokens of frames below `frame`, and append those of num_frames new frames.

        If `frame` is not on the grid of the tokens held, or these do not reach it, a new run begins there. A token of
        which not every frame is used is left out. tokens None: those of the new frames are not known.
        """
        new = self.tokens[:0] if tokens is None else tokens[: num_frames // self.patch]
        keep, off_grid = divmod(frame - self.first, self.patch)
        if off_grid or not 0 <= keep <= len(self.tokens):
            return TokenRun(frame, new, self.patch)
        return TokenRun(self.first, np.concatenate((self.tokens[:keep], new)), self.patch)

    def trimmed(self, frame: int) -> TokenRun:
        """Drop the tokens that end at or before `frame`."""
        drop = min(max(0, (frame - self.first) // self.patch), len(self.tokens))
        return TokenRun(self.first + drop * self.patch, self.tokens[drop:], self.patch)

    def before(self, frame: int, num_frames: int) -> Float32Array | None:
        """The tokens of exactly the num_frames frames that end just before `frame`; None if they are not held."""
        stop, off_grid = divmod(frame - self.first, self.patch)
        count, ragged = divmod(num_frames, self.patch)
        if off_grid or ragged or not count <= stop <= len(self.tokens):
            return None
        return self.tokens[stop - count : stop]


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """Consecutive frames from `first` on. Every change makes a new value, so that views of an old one stay valid.

    rows: (T, row_width) float32, for the wire. features: (T, D) float32, normalized, for histories. motion_from: the
    first frame to which a history may reach back. cut_at: the first frame that does not continue the one before it.
    older: the motion before earlier cuts, each (begin, end). held_to: the end of the last held pose; below it, features
    are not those of the rows.
    """

    first: int
    rows: Float32Array
    features: Float32Array
    run: TokenRun
    motion_from: int = 0
    cut_at: int = 0
    older: tuple[tuple[int, int], ...] = ()
    held_to: int = 0

    @classmethod
    def empty(cls, row_width: int, feature_dim: int, token_width: int = 0, patch: int = 1) -> Timeline:
        return cls(
            0,
            np.empty((0, row_width), np.float32),
            np.empty((0, feature_dim), np.float32),
            TokenRun(0, np.empty((0, token_width), np.float32), patch),
        )

    @property
    def end(self) -> int:
        """The first frame after those held."""
        return self.first + len(self.rows)

    @property
    def cuts(self) -> tuple[int, ...]:
        """The frames held that do not continue the one before, ascending."""
        return tuple(sorted({self.cut_at, *(end for _, end in self.older)}))

    @property
    def stretches(self) -> tuple[tuple[int, int], ...]:
        """The motion held, split at cuts, each part (begin, end): a history may be any frames within one part."""
        return tuple((max(begin, self.first), end) for begin, end in (*self.older, (self.motion_from, self.end)))

    def spliced(
        self,
        frame: int,
        rows: Float32Array,
        features: Float32Array,
        tokens: Float32Array | None = None,
        anew: bool = False,
    ) -> Timeline:
        """Keep the frames below `frame`, which must be held or the end, and append new ones.

        anew: they do not continue the old ones, so no history may span both.
        """
        keep = frame - self.first
        return Timeline(
            self.first,
            np.concatenate((self.rows[:keep], rows)),
            np.concatenate((self.features[:keep], features)),
            self.run.spliced(frame, tokens, len(rows)),
            frame if anew else self.motion_from,
            frame if anew else self.cut_at,
            (*self.older, (self.motion_from, frame)) if anew and frame > self.motion_from else self.older,
            self.held_to,
        )

    def held(self, num_frames: int) -> Timeline:
        """Repeat the last row num_frames times. Histories skip these frames: at the new end they are as at the old one.

        A still pose in a history would be motion that the model has to explain, and its features, which include
        velocities, would be wrong.
        """
        return Timeline(
            self.first,
            np.concatenate((self.rows, np.repeat(self.rows[-1:], num_frames, axis=0))),
            np.concatenate((np.repeat(self.features[:1], num_frames, axis=0), self.features)),
            TokenRun(self.run.first + num_frames, self.run.tokens, self.run.patch),
            self.motion_from + num_frames,
            self.cut_at,
            held_to=self.end + num_frames,
        )

    def trimmed(self, frame: int) -> Timeline:
        """Drop the frames below `frame`; their memory is freed by the next splice, which makes new arrays anyway."""
        drop = max(0, frame - self.first)
        return Timeline(
            self.first + drop,
            self.rows[drop:],
            self.features[drop:],
            self.run.trimmed(frame),
            self.motion_from,
            self.cut_at,
            tuple(each for each in self.older if each[1] > frame),
            self.held_to,
        )

    def rows_between(self, begin: int, end: int) -> Float32Array:
        return self.rows[begin - self.first : end - self.first]

    def features_before(self, frame: int, num_frames: int) -> Float32Array:
        """The features of the num_frames frames that end just before `frame`."""
        stop = frame - self.first
        return self.features[stop - num_frames : stop]

    def made_before(self, frame: int, most: int) -> Float32Array:
        """Up to `most` rows just before a frame: none from before a cut, a held pose, or the start of the session."""
        begin = max(0, self.first, self.motion_from, self.held_to, frame - most)
        return self.rows_between(min(begin, frame), frame)

    def tokens_before(self, frame: int, num_frames: int) -> Float32Array | None:
        """The tokens of the same frames; None if whole tokens do not cover them exactly, or there are none."""
        return self.run.before(frame, num_frames) if num_frames else None


def first_timeline(facts: ModelFacts, prior_rows: Float32Array | None, prior_features: Float32Array | None) -> Timeline:
    """A session's first timeline: empty, or the frames just before frame 0, which count from -H."""
    if prior_rows is None or prior_features is None:
        return Timeline.empty(facts.row_width, facts.feature_dim, facts.token_width, facts.patch)
    run = TokenRun(0, np.empty((0, facts.token_width), np.float32), facts.patch)
    first = -len(prior_rows)
    return Timeline(first, prior_rows, prior_features, run, motion_from=first, cut_at=first)
