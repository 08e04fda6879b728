"""Cut: what a character continues from after it was put elsewhere: other frames, older ones, or a start pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.session.timeline import Timeline, TokenRun
from motiongen_server.engine.types import Code, EventRefused, Float32Array, ModelFacts, StartPose


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """start_pose: where it stands. rows, features: the frames that it continues from, None if it begins standing."""

    start_pose: StartPose
    rows: Float32Array | None = None
    features: Float32Array | None = None

    def timeline_at(self, frame: int, facts: ModelFacts) -> Timeline:
        """The timeline of a window that begins with this cut at a frame."""
        rows, features = self.rows, self.features
        if rows is None or features is None:
            rows = np.empty((0, facts.row_width), np.float32)
            features = np.empty((0, facts.feature_dim), np.float32)
        run = TokenRun(frame, np.empty((0, facts.token_width), np.float32), facts.patch)
        first = frame - len(rows)
        return Timeline(first, rows, features, run, motion_from=first)


def own_frames(
    timeline: Timeline, frame: int, sent_to: int, most: int, patch: int
) -> tuple[Float32Array, Float32Array]:
    """The rows (H, row_width) and features (H, D) from which a session continues at an earlier frame of its own.

    They are the frames just before that one, whole patches of them, at most `most` but at least one patch. sent_to: the
    first frame not sent to the client. Raises EventRefused if not even a patch of them is held.
    """
    could = []
    for begin, end in timeline.stretches:
        low, high = max(begin + patch, timeline.held_to, 1), min(end, sent_to)
        if low <= frame <= high:
            length = min(max(most, patch), frame - begin) // patch * patch
            return timeline.rows_between(frame - length, frame), timeline.features_before(frame, length)
        if low <= high:
            could.append(f"{low} to {high}")
    given = f"the session cannot continue from its frame {frame}: the frames before it are not held"
    allowed = f"frames {', '.join(could)}" if could else f"a frame once {patch} frames before it were sent"
    raise EventRefused(Code.FAILED_PRECONDITION, "FRAME_NOT_HELD", given, "seek.frame", allowed)
